//! Cleaning of a trained scene: which Gaussians no view shows, which float in free space, and which contribute least.
//!
//! Nothing here edits a scene: each function says something about every row, and the caller decides what to keep.
//!
//! - [`Contribution`]: the pixels that each Gaussian covers in the pictures of some cameras, by derivatives of renders.
//! - [`isolated`]: Gaussians that are farther from their neighbours than these are from theirs, by a k-d tree.
//! - [`Bulk`]: the range of the values of most Gaussians.
//!
//! A *floater* is isolated and never the front of a view: nowhere is it the surface that a picture shows.

mod bulk;
mod contribution;
mod isolation;
#[cfg(test)]
mod tests;

pub use bulk::Bulk;
pub use contribution::{Contribution, UNSEEN_PX};
pub use isolation::{ISOLATED, isolated};
