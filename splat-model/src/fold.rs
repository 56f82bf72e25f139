//! Long rows in pieces. Burn 0.22 without `autotune` reduces each row in one thread of a GPU.

use burn::tensor::Tensor;
use burn::tensor::kind::Numeric;

/// Numbers of a piece, and of the longest row that stays whole.
const PIECE: usize = 256;
const LONG: usize = 16 * PIECE;

/// `[R, P, L]`: the rows `[R, N]`, on a GPU in pieces. `neutral` fills the last piece and must not change the reduction.
pub(crate) fn folded<K: Numeric>(rows: Tensor<2, K>, neutral: f64) -> Tensor<3, K> {
    let [count, length] = rows.dims();
    if length <= LONG || !splat_op::is_gpu(&rows.device()) {
        return rows.unsqueeze_dim(1);
    }
    let pieces = length.div_ceil(PIECE);
    let missing = pieces * PIECE - length;
    let (device, dtype) = (rows.device(), rows.dtype());
    let rows = match missing {
        0 => rows,
        _ => Tensor::cat(vec![rows, Tensor::full([count, missing], neutral, (&device, dtype))], 1),
    };
    rows.reshape([count, pieces, PIECE])
}

#[cfg(test)]
mod tests;
