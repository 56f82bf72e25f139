//! Differentiable Gaussian splatting as custom operations of the Burn framework.

pub mod camera;
mod check;
pub mod error;
pub mod exact;
pub mod options;

pub mod blend;
pub mod project;
pub mod shade;
pub mod tile;

mod bind;
mod linalg;
mod op;
mod real;
mod render;
mod stages;

pub use camera::{Camera, CameraModel, Intrinsics};
pub use error::SplatError;
pub use op::{Slot, SplatBackend};
pub use options::RenderOptions;
pub use render::{Rendered, render};
pub use stages::{Colour, Ellipses, Extras, Picture, Projected, Splats, Tiles, blend, project, shade, tile};
