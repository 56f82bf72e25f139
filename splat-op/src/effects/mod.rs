//! What effects do to a camera, to Gaussians, to ellipses, and to a render before the loss.

pub mod bilateral;
pub mod colour_map;
pub mod depth_miss;
pub mod environment;
pub mod optics;
pub mod pose;
pub mod smooth;
