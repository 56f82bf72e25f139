//! Differentiable Gaussian splatting as custom operations of the Burn framework.
//!
//! [`render`] renders [`Splats`] as [`Camera`]s see them. Its stages are public functions: [`project`](fn@project),
//! [`evaluate_sh`](fn@evaluate_sh), [`intersect`](fn@intersect) and [`rasterize`](fn@rasterize). Tensor code may run between them. The
//! module of each stage states its equations, their sources, shapes and units. The reference renderer is in the crate `splat-hard-cases`.
//!
//! The example renders two Gaussians in one call, and then stage by stage, where each stage takes and returns tensors: a model of one
//! number per Gaussian scales the opacities and receives gradients. It changes the ellipses before `intersect` lists them.
//!
//! ```
//! use burn::tensor::{Device, Tensor};
//! use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, intersect, project, rasterize, render};
//!
//! let device = Device::flex().autodiff();
//! let means = Tensor::<2>::from_floats([[0.0, 0.0, 2.0], [0.3, 0.0, 3.0]], &device).require_grad();
//! let features = Tensor::<2>::from_floats([[1.0, 0.5, 0.1], [0.1, 0.3, 0.9]], &device);
//! let splats = Splats {
//!     means: means.clone(),
//!     rotations: Tensor::from_floats([[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]], &device),
//!     scales: Tensor::from_floats([[0.3, 0.3, 0.3], [0.4, 0.2, 0.2]], &device),
//!     opacities: Tensor::from_floats([0.9, 0.8], &device),
//!     colour: Colour::Features(features.clone()),
//! };
//! let camera = Camera::new(Intrinsics::centred(32, 24, 30.0), &glam::DAffine3::IDENTITY, &device);
//! let options = RenderOptions::standard().with_depth(true);
//! let rendered = render(&splats, std::slice::from_ref(&camera), &Extras::default(), &options)?;
//! assert_eq!(rendered.colour.dims(), [1, 24, 32, 3]);
//! let gradients = rendered.colour.mean().backward();
//! assert_eq!(means.grad(&gradients).expect("tracked").dims(), [2, 3]);
//!
//! let visible = Tensor::<1>::from_floats([1.0, 0.5], &device).require_grad();
//! let projected = project(&splats, &camera, &Extras::default(), &options)?;
//! let mut ellipses = projected.ellipses();
//! ellipses.opacity = ellipses.opacity * visible.clone();
//! let projected = ellipses.pack(projected.intrinsics())?;
//! let intersections = intersect(&projected, &options)?;
//! let picture = rasterize(&projected, &features, &intersections, &Extras::default(), &options)?;
//! assert_eq!(picture.depth.map(|depth| depth.dims()), Some([24, 32, 1]));
//! let gradients = picture.alpha.mean().backward();
//! assert_eq!(visible.grad(&gradients).expect("tracked").dims(), [2]);
//! # Ok::<(), splat_op::SplatError>(())
//! ```
//!
//! `docs/IN_YOUR_MODEL.md` lists the inputs that have gradients, the device that each stage runs on, and the limits.

#![cfg_attr(docsrs, feature(doc_cfg))]
#![warn(missing_docs)]

mod abilities;
pub mod backend;
pub mod camera;
mod check;
mod counters;
mod effects;
pub mod error;
#[cfg(feature = "cube")]
mod gpu;
mod limits;
mod linalg;
mod product;
mod read;
mod record;
mod simd;
mod stages;
mod tasks;
mod tensor_code;
#[doc(hidden)]
pub mod test_hooks;
#[cfg(test)]
mod testing;
mod training;

#[cfg(feature = "cube")]
pub use abilities::Abilities;
pub use abilities::{is_gpu, largest_tensor};
pub use backend::custom_grad::with_gradient;
pub use camera::{Camera, CameraModel, Intrinsics, Projector};
pub use effects::{bilateral, colour_map, depth_miss, environment, optics, pose, smooth};
pub(crate) use error::Result;
pub use error::SplatError;
pub use product::{mixed, product};
pub use read::read_back;
pub use stages::colour::{colours, colours_up_to, evaluate_sh, visible_colours};
pub use stages::contributors::{Contributors, MAX_CONTRIBUTORS, contributors};
pub use stages::intersections::{Intersections, intersect, truncated_views};
pub use stages::normals::normals;
pub use stages::options::{Accumulation, ListLength, MAX_UNCULLED_INTERSECTIONS, Projection, RenderOptions};
pub use stages::panorama::{Equirectangular, Panorama};
pub use stages::projected::{Ellipses, Projected, project};
pub use stages::render::{render, render_each, render_view};
pub use stages::rendered::{Rendered, rasterize};
pub use stages::splats::{Colour, Extras, Splats};
pub use stages::tile_mask::intersect_masked;
// Three names of stages are those of a function and of a module.
pub use stages::{intersect, options, project, rasterize, rasterize_rays, ray_space, sh};
pub use tensor_code::{in_tensor_code, is_tensor_code};
pub use training::activate::RawSplats;
pub use training::{activate, adam, argsort, loss};
// Re-exports of the crates in public signatures, so that callers use the same versions.
pub use {burn, glam};
