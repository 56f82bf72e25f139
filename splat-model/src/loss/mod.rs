//! Losses that compare a render with a photograph. Pictures are `[height, width, channels]`, display-referred, 0 to 1.
//!
//! Every loss is ordinary tensor code that returns a `[1]` tensor to call `backward` on. [`Truth`] holds the quantities that
//! depend on the photograph alone, so that a training loop computes them once.

pub mod photometric;
pub mod regularise;
pub mod ssim;
pub mod surface;

pub use photometric::{DEFAULT_LAMBDA, d_ssim, l1, photometric};
pub use ssim::{Truth, ssim, ssim_map};

pub(crate) use splat_op::with_gradient;

#[cfg(test)]
mod tests;
