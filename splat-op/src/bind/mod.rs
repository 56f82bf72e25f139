//! Where the stages meet Burn: its CPU and GPU backends, its fusion and its autodiff. Kernels and twins know none of them.

pub(crate) mod activate;
pub(crate) mod attach;
mod autodiff;
mod cpu;
#[cfg(feature = "cube")]
pub(crate) mod cube;
#[cfg(feature = "fusion")]
pub(crate) mod fusion;
pub(crate) mod host;
pub(crate) mod rays;
mod rays_autodiff;
#[cfg(feature = "cube")]
mod rays_cube;
