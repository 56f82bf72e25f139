//! Stable sorts of the rows of a scene by a key, on the device of the keys. Burn's sorts read keys back from GPUs. Not differentiable.
//!
//! `order[k]` is the row of the `k`-th smallest key; rows of equal keys keep their order. On a GPU this is the radix sort of
//! `stages/intersect/sort.rs`, on a CPU a parallel sort whose result does not depend on the number of threads.
//!
//! Shapes: keys `[N]` → order `[N]`, i32.

pub(crate) mod cpu;
mod operation;
mod tensors;
#[cfg(test)]
mod tests;

use burn::tensor::{DType, Int, Tensor};

use crate::backend::apply;
use crate::tensor_code::is_tensor_code;

/// Bits of a key that is any non-negative number.
pub const ALL_BITS: u32 = 31;

/// Returns the order of `keys`, `[N]`: whole numbers from 0 to `2^bits − 1`, without autodiff. Fewer bits cost less on a GPU.
pub fn argsort(keys: Tensor<1, Int>, bits: u32) -> Tensor<1, Int> {
    if is_tensor_code() {
        return tensors::argsort(keys);
    }
    let keys = if keys.dtype() == DType::I32 { keys } else { keys.cast(DType::I32) };
    apply(operation::Argsort { bits: bits.clamp(1, ALL_BITS), are_floats: false }, [keys.into()]).int(0)
}

/// Returns the order of `keys`, `[N]`: numbers that are not negative, nor −0, without autodiff. NaN comes last.
pub fn argsort_floats(keys: Tensor<1>) -> Tensor<1, Int> {
    let keys = if keys.dtype() == DType::F32 { keys } else { keys.cast(DType::F32) };
    if is_tensor_code() {
        return tensors::argsort_floats(keys);
    }
    apply(operation::Argsort { bits: ALL_BITS, are_floats: true }, [keys.into()]).int(0)
}
