//! The stages of a render as public functions. Tensor code may run between them.

// The stages, in the order in which data flows; the blank lines keep rustfmt from sorting them.
pub mod project;

pub mod sh;

pub mod intersect;

pub mod rasterize;

// What `rasterize` takes in place of ellipses for Gaussians seen along rays.
pub mod ray_space;

pub mod rasterize_rays;

// Their inputs, checks and results with the functions that make them, and all stages in one call.
pub(crate) mod checked;
pub(crate) mod colour;
pub(crate) mod contributors;
mod covariances;
pub(crate) mod intersections;
pub(crate) mod normals;
pub mod options;
pub(crate) mod panorama;
pub(crate) mod projected;
pub(crate) mod render;
pub(crate) mod rendered;
pub(crate) mod splats;
pub(crate) mod tile_mask;
