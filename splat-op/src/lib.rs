//! Differentiable Gaussian splatting as custom operations of the Burn framework.

pub mod camera;
pub mod error;
pub mod options;

pub use camera::{Camera, CameraModel, Intrinsics};
pub use error::SplatError;
pub use options::RenderOptions;
