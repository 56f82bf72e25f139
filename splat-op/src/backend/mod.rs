//! Operations on Burn's CPU and GPU backends, with fusion and autodiff. Kernels and twins know none of them.
//!
//! An operation is one type that implements [`Operation`]: the shapes of its outputs, its CPU twin, its kernels, and the gradients of its
//! inputs. [`apply`] runs it on tensors of any device. The parts here bind all operations at once: `host.rs` to
//! [`Flex`](burn::backend::Flex) and [`NdArray`](burn::backend::NdArray), `cube.rs` to every CubeCL runtime, `list.rs` to Burn's fusion,
//! and `autodiff.rs` holds the one backward node. Each stage has its operations in a file `operation.rs`.

mod autodiff;
#[cfg(feature = "cube")]
pub(crate) mod cube;
pub(crate) mod custom_grad;
pub(crate) mod host;
mod list;
mod operation;
#[cfg(test)]
mod tests;

#[cfg(feature = "cube")]
pub use cube::{GpuArgs, GpuOutput};
pub use host::{Host, HostArgs, HostOutput};
pub use list::Slot;
pub(crate) use operation::apply_all;
pub use operation::{Args, MAX_DIFFERENTIABLE, Operation, Outputs, Spec, apply};

pub use crate::simd::real::Real;
