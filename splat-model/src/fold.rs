//! Long rows in pieces. Burn 0.22 reduces each row in one thread of a GPU, which takes an H200 about 14 ns for each number.

use burn::tensor::Tensor;
use burn::tensor::kind::Basic;

/// Numbers of a piece, and of a row that stays whole.
const PIECE: usize = 256;
const LONG: usize = 16 * PIECE;

/// `[R, P, L]`: the rows `[R, N]` in pieces, on a GPU, or whole. `padding` makes the numbers that fill the last piece, which must not change
/// the reduction.
pub(crate) fn folded<K: Basic>(rows: Tensor<2, K>, padding: impl FnOnce([usize; 2]) -> Tensor<2, K>) -> Tensor<3, K> {
    let [count, length] = rows.dims();
    if length <= LONG || !splat_op::is_gpu(&rows.device()) {
        return rows.unsqueeze_dim(1);
    }
    let pieces = length.div_ceil(PIECE);
    let missing = pieces * PIECE - length;
    let rows = if missing == 0 { rows } else { Tensor::cat(vec![rows, padding([count, missing])], 1) };
    rows.reshape([count, pieces, PIECE])
}

#[cfg(test)]
mod tests;
