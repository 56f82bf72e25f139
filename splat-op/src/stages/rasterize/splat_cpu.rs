//! What a splat is to the CPU twin: the form that its loops over a tile's pixels read, its alpha at a vector of pixels, and what a
//! pair adds to its row of sums. Both passes are written once, over these traits.

use fearless_simd::prelude::*;

use super::pixels::TilePixels;
use super::tile_blocks::TileBlocks;
use super::{Layers, MOMENTS, RasterizeSpec};
use crate::intersect::PixelBox;
use crate::ray_space::{LensLimits, SLOPES};
use crate::simd::real::Real;

/// The view that footprints are read for.
pub(crate) struct FootprintView<'a, F> {
    pub spec: &'a RasterizeSpec,
    pub lens: Option<LensLimits<F>>,
    /// `[N]` or empty: boxes of the Gaussians.
    pub boxes: &'a [PixelBox],
}

/// A Gaussian in the form that the loops over a tile's pixels read.
pub(crate) trait Footprint<F: Real>: Copy + Default + Send + Sync + 'static {
    /// Number of columns of a row of sums between the channels and the sums of absolute values.
    const EXTRA_COLUMNS: usize;
    /// Whether its depth differs from pixel to pixel.
    const ALONG_RAYS: bool;
    /// The inverse of the factor in whitened coordinates.
    const UNSCALE: f64;
    /// Its constants for a tile, one copy in each lane.
    type Broadcast<S: Simd>: FootprintLanes<S, F>;

    /// Reads Gaussian `i`.
    fn read(inputs: &Layers<&[F]>, i: usize, view: &FootprintView<F>) -> Self;

    /// Returns the blocks of a tile in which it may show, a bit for each.
    fn met<S: Simd>(&self, simd: S, blocks: &TileBlocks<F>) -> u16;

    /// Returns its constants for the tile whose upper border is at `top` px.
    fn lanes<S: Simd>(&self, simd: S, top: F) -> Self::Broadcast<S>;
}

/// A Gaussian's constants, one copy in each lane.
pub(crate) trait FootprintLanes<S: Simd, F: Real> {
    /// Values at a vector of pixels that do not depend on their rows.
    type Column;
    /// Values at a vector of pixels that its sums are made of.
    type Point;

    fn opacity(&self) -> F::Block<S>;

    /// Returns the values of the pixels with centres `x`, px.
    fn column(&self, x: F::Block<S>) -> Self::Column;

    /// Evaluates the Gaussian at the vector of pixels of `column` at `place`.
    fn at(&self, column: &Self::Column, pixels: &TilePixels<F>, place: usize) -> SplatAt<S, F, Self::Point>;

    /// Adds pairs, from their `h` and, along rays, from their weights times the gradients of depth.
    fn add(
        &self,
        sums: &mut PairSums<S, F>,
        point: &Self::Point,
        h: F::Block<S>,
        of_depth: Option<F::Block<S>>,
        absolute: bool,
    );
}

/// A Gaussian at a vector of pixels.
pub(crate) struct SplatAt<S: Simd, F: Real, P> {
    /// Its alphas are the opacity times `2^−exponent`.
    pub exponent: F::Block<S>,
    /// The pixels that it may show in.
    pub near: <F::Block<S> as SimdBase<S>>::Mask,
    /// The factor of its depth; not read unless it is seen along rays.
    pub depth_factor: F::Block<S>,
    pub point: P,
}

/// The largest number of channels that is known at compile time.
const MOST_FEATURES: usize = 4;

/// Sums of a Gaussian over pixels.
pub(crate) struct PairSums<S: Simd, F: Real> {
    /// Of `h, h u, h v, h u², h u v, h v²`.
    pub moments: [F::Block<S>; MOMENTS],
    /// Along rays, the gradients of the depth slope, the thickness and the relative depth of the centre.
    pub slopes: [F::Block<S>; SLOPES],
    /// Of absolute values.
    pub absolute: [F::Block<S>; 2],
}

impl<S: Simd, F: Real> PairSums<S, F> {
    #[inline(always)]
    pub fn new(zero: F::Block<S>) -> Self {
        Self { moments: [zero; MOMENTS], slopes: [zero; SLOPES], absolute: [zero; 2] }
    }

    /// Writes the totals to a row: moments and `features`, then behind the columns of `channels` the first `slopes`, and sums of absolute
    /// values where there is room.
    #[inline(always)]
    pub fn store<const C: usize>(&self, features: &[F::Block<S>; C], row: &mut [F], channels: usize, slopes: usize) {
        let mut sums = [self.moments[0]; MOMENTS + MOST_FEATURES];
        sums[..MOMENTS].copy_from_slice(&self.moments);
        sums[MOMENTS..MOMENTS + C].copy_from_slice(features);
        F::reduce_sums(&sums[..MOMENTS + C], &mut row[..MOMENTS + C]);
        let behind = &mut row[MOMENTS + channels..];
        for (to, sum) in behind.iter_mut().zip(self.slopes).take(slopes) {
            *to = sum.reduce_sum();
        }
        for (to, sum) in behind[slopes..].iter_mut().zip(self.absolute) {
            *to = sum.reduce_sum();
        }
    }
}
