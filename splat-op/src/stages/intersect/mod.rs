//! Intersects Gaussians with tiles: ellipses → for each 16 × 16 tile of the picture, the Gaussians that can show in it, front to back.
//!
//! The stage is not differentiable and changes no result: `rasterize` decides which Gaussian contributes to which
//! pixel, and these lists only leave out pairs that cannot contribute. A Gaussian extends as far as its alpha is at
//! least `alpha_min`: the ellipse `u² + v² <= 2 ln(opacity / alpha_min)`. A tile lists it if the rectangle of the
//! tile's pixel centres meets that ellipse, with a margin for the rounding of `rasterize`. The CPU twin computes the
//! interval that the ellipse spans on each row of tiles; the kernel tests each tile of the bounding box.
//!
//! The lists live in a cell beside the tensors, because their length depends on the data. See `Kept`.

pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod emit;
#[cfg(feature = "cube")]
mod expected;
pub(crate) mod extent;
#[cfg(feature = "cube")]
pub(crate) mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
pub(crate) mod operation;
#[cfg(feature = "cube")]
pub(crate) mod pending;
#[cfg(feature = "cube")]
pub(crate) mod sort;
#[cfg(all(test, feature = "cube"))]
mod sort_kernel_tests;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

use std::any::Any;
use std::sync::{Arc, OnceLock};

use crate::options::RenderOptions;

/// Pixels along each side of a tile.
pub const TILE_SIZE: usize = 16;

/// Number of pixels in a tile.
pub(crate) const TILE_PIXELS: usize = TILE_SIZE * TILE_SIZE;

/// Number of tiles along x and y that cover a picture.
pub(crate) fn tile_grid(width: usize, height: usize) -> [usize; 2] {
    [width.div_ceil(TILE_SIZE), height.div_ceil(TILE_SIZE)]
}

/// Parameters that decide which tiles list a Gaussian.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cut<M> {
    pub alpha_min: f64,
    /// Whether the lists of the CPU hold the boxes of the Gaussians.
    pub boxes: bool,
    /// `[tiles along y, tiles along x]`: zero for tiles with empty lists.
    pub mask: Option<M>,
}

impl<M> Cut<M> {
    pub fn of(options: &RenderOptions) -> Self {
        Self { alpha_min: options.alpha_min, boxes: options.along_rays(), mask: None }
    }
}

/// Box around the pixels that may see a Gaussian, px.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PixelBox {
    pub middle: [f32; 2],
    /// Half the size.
    pub half: [f32; 2],
}

impl PixelBox {
    /// A box around every picture.
    pub const EVERYWHERE: Self = Self { middle: [0.0; 2], half: [1e30; 2] };
}

/// Lists of intersections of one view. An intersection is a pair of a tile and a Gaussian.
#[derive(Debug, Default)]
pub(crate) struct IntersectionLists {
    /// `[tiles + 1]`: index of each tile's first intersection; tiles run along x, then y.
    pub tile_start: Vec<usize>,
    /// `[H]`: the Gaussian of each intersection; tile by tile, within a tile front to back.
    pub gaussian: Vec<u32>,
    /// `[V]`: the Gaussians that have intersections, by index.
    pub visible: Vec<u32>,
    /// `[V + 1]`: index of each visible Gaussian's first entry in `intersection_of_visible`.
    pub visible_start: Vec<u32>,
    /// `[H]`: places in `gaussian` of each visible Gaussian's intersections. Sums over a Gaussian's intersections run in this order.
    pub intersection_of_visible: Vec<u32>,
    /// `[N]`, or empty: the boxes of all Gaussians, see [`Cut`].
    pub boxes: Vec<PixelBox>,
}

/// Holds what an operation computes for others that run later, of any type. It is passed to them as an ordinary argument; a tensor of that
/// operation among their inputs orders them for backends that run lazily.
#[derive(Clone, Debug, Default)]
pub(crate) struct Kept(Arc<OnceLock<Box<dyn Any + Send + Sync>>>);

impl Kept {
    /// Keeps a value. If there is one already, it is the same.
    pub fn keep<T: Any + Send + Sync>(&self, value: T) {
        let _ = self.0.set(Box::new(value));
    }

    /// Returns the value, if there is one of this type.
    pub fn kept<T: Any>(&self) -> Option<&T> {
        self.0.get()?.downcast_ref()
    }

    /// Returns the lists of a view, on the host or on a device.
    pub fn read<T: Any>(&self) -> &T {
        self.kept().expect("who reads lists is on their device and has their counts as an input, and so runs later")
    }
}
