//! Operations on Burn's CPU and GPU backends, with fusion and autodiff. Kernels and twins know none of them.
//!
//! An operation is one type that implements [`Operation`]: the shapes of its outputs, its CPU twin, its kernels, and the gradients of its
//! inputs. [`apply`] runs it on tensors of any device. `apply.rs` binds all operations at once to [`Flex`](burn::backend::Flex),
//! [`NdArray`](burn::backend::NdArray), every CubeCL runtime and Burn's fusion, and `autodiff.rs` holds the one backward node. Each stage has its operations in a file `operation.rs`.

mod apply;
mod args;
mod autodiff;
#[cfg(feature = "cube")]
pub(crate) mod cube;
pub(crate) mod custom_grad;
pub(crate) mod host;
mod list;
mod operation;
#[cfg(test)]
mod tests;

pub(crate) use apply::apply_all;
pub use apply::{Outputs, apply};
pub use args::Args;
#[cfg(feature = "cube")]
pub use cube::{GpuArgs, GpuOutput};
#[cfg(feature = "cube")]
pub(crate) use cube::{buffer, gpu_outputs, owned};
pub use host::{Host, HostArgs, HostOutput};
pub(crate) use host::{float_outputs, slices};
pub use list::Slot;
pub use operation::{MAX_DIFFERENTIABLE, Operation, Spec};

pub use crate::simd::real::Real;
