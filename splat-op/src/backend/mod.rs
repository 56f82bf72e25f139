//! Operations on Burn's CPU and GPU backends, with fusion and autodiff. Kernels and twins know none of them.
//!
//! An operation is one type that implements [`Operation`]: the shapes of its outputs, its CPU twin, its kernels, and the gradients of its
//! inputs. [`apply`] runs it on tensors of any device. The parts here bind all operations at once: `host.rs` to
//! [`Flex`](burn::backend::Flex) and [`NdArray`](burn::backend::NdArray), `cube.rs` to every CubeCL runtime, `list.rs` to Burn's fusion,
//! and `autodiff.rs` holds the one backward node. Each stage has its operations in a file `operation.rs`.

mod autodiff;
#[cfg(feature = "cube")]
pub(crate) mod cube;
pub(crate) mod host;
mod list;
mod operation;

#[cfg(feature = "cube")]
pub use cube::{Bound, GpuArgs};
pub use host::{Found, Host, HostArgs};
pub use list::{List, Slot, Tensors};
pub use operation::{Call, MAX_DIFFERENTIABLE, Operation, OperationBackend, Outputs, Spec, apply};

pub use crate::simd::real::Real;
