//! What a render is trained against. Pictures are `[height, width, channels]`, display-referred, 0 to 1.
//!
//! Every loss is ordinary tensor code that returns a `[1]` tensor to call `backward` on. [`Truth`] holds what depends on
//! the photograph alone, so that a training loop computes it once.

pub mod l1;
pub mod photometric;
pub mod regularise;
pub mod ssim;

pub use l1::{l1, weighted_l1};
pub use photometric::{DEFAULT_LAMBDA, photometric};
pub use ssim::{Truth, d_ssim, ssim, ssim_map};

use burn::tensor::Tensor;

/// A `[1]` tensor that holds `value` and whose derivative with respect to `variable` is `gradient`.
///
/// For losses whose gradient is cheaper in closed form than as a graph of small operations. `value` and `gradient` are
/// without autodiff; `gradient` has the shape of `variable`. The surrogate `Σ variable · gradient` has that derivative,
/// and subtracting its own value leaves exactly `value`.
pub(crate) fn with_gradient<const D: usize>(variable: Tensor<D>, value: Tensor<1>, gradient: Tensor<D>) -> Tensor<1> {
    let surrogate = (variable * gradient).sum();
    let offset = surrogate.clone().inner();
    (surrogate - offset) + value
}

#[cfg(test)]
mod tests;
