//! Functions that the kernels of both passes share, so that the backward pass sees the values of the forward pass: the
//! arithmetic of a layer at a pixel, and the numbering of buckets and segments.

use cubecl::prelude::*;

use crate::gpu::math::Vec2;
use crate::intersect::TILE_SIZE;
use crate::intersect::forward::TileLists;
use crate::options::RenderOptions;

/// Number of places in a bucket. Within a bucket the transmittance of a pixel is relative to that before it, and one
/// word says which places a block of pixels evaluates.
pub(super) const BUCKET: usize = 32;

/// Number of buckets in a segment.
pub(super) const BUCKETS: usize = 4;

/// Number of places in a segment. The trace keeps a few values per pixel of a segment, which do not depend on any other
/// segment, so the backward pass can process all segments at once.
pub(super) const SEGMENT: usize = BUCKETS * BUCKET;

/// Largest number of channels for which colours go through shared memory, and the trace keeps the sums of each segment.
/// With more channels, neither would fit.
pub(crate) const FEW: usize = 4;

/// Four numbers that are read from shared memory at once.
pub(crate) type Four = Vector<f32, Const<4>>;

#[cube]
pub(crate) fn four(a: f32, b: f32, c: f32, d: f32) -> Four {
    let mut all = Four::empty();
    all.insert(0usize, a);
    all.insert(1usize, b);
    all.insert(2usize, c);
    all.insert(3usize, d);
    all
}

/// What the kernels read of a view's Gaussians.
#[derive(CubeType, CubeLaunch)]
pub(crate) struct SplatInputs {
    /// `[N, 7]`: packed ellipses.
    pub projected: Box<[f32]>,
    /// `[N, C]`
    pub features: Box<[f32]>,
    /// `[N, 9]`, with a lens `[N, 15]`: rows of `ray_space`, for Gaussians seen along rays.
    pub ray_space: ComptimeOption<Box<[f32]>>,
    /// `[H, W, 2]`: slopes of the pixels' rays, for Gaussians seen along rays through a lens.
    pub slopes: ComptimeOption<Box<[f32]>>,
    pub lists: TileLists,
}

#[cube]
impl SplatInputs {
    /// Returns a value of the rows of `ray_space`, zero if there are none.
    pub fn ray_value(&self, at: usize) -> f32 {
        #[comptime]
        match &self.ray_space {
            ComptimeOption::Some(rows) => rows[at],
            ComptimeOption::None => 0.0f32.runtime(),
        }
    }
}

/// Size of the picture in pixels, its tiles along x, and thresholds of the render.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
pub(crate) struct RasterFrame {
    pub width: u32,
    pub height: u32,
    pub tiles_x: u32,
    pub alpha_min: f32,
    pub alpha_max: f32,
    /// Negative for no threshold.
    pub transmittance_min: f32,
    /// Natural logarithm of `alpha_min`, or of the least positive f32 if that is larger.
    pub log_least: f32,
}

/// A pixel of a tile.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct TilePixel {
    /// Centre of its column and of the tile's first row, px, and its row within the tile.
    pub x: f32,
    pub top: f32,
    pub row: f32,
    /// Whether it is in the picture, and its index there.
    pub inside: bool,
    pub index: usize,
    /// Slopes of its ray, arbitrary outside the picture, if Gaussians are seen along rays through a lens.
    pub ray: ComptimeOption<Vec2>,
}

/// Returns the column and row of a tile's first pixel.
#[cube]
pub(crate) fn tile_origin(tile: u32, frame: &RasterFrame) -> (u32, u32) {
    (tile % frame.tiles_x * comptime!(TILE_SIZE as u32), tile / frame.tiles_x * comptime!(TILE_SIZE as u32))
}

#[cube]
impl TilePixel {
    /// Returns pixel `in_tile`, counted row by row, of the tile at `origin`.
    pub fn of(origin: (u32, u32), in_tile: u32, inputs: &SplatInputs, frame: &RasterFrame) -> TilePixel {
        let (first_column, first_row) = origin;
        let column = first_column + in_tile % comptime!(TILE_SIZE as u32);
        let row = in_tile / comptime!(TILE_SIZE as u32);
        let inside = column < frame.width && first_row + row < frame.height;
        let index = ((first_row + row) * frame.width + column) as usize;
        TilePixel {
            x: f32::cast_from(column) + 0.5,
            top: f32::cast_from(first_row) + 0.5,
            row: f32::cast_from(row),
            inside,
            index,
            ray: ray_of(inputs, inside, index),
        }
    }
}

/// Returns the slopes of a pixel's ray, if there are rays.
#[cube]
fn ray_of(inputs: &SplatInputs, inside: bool, index: usize) -> ComptimeOption<Vec2> {
    #[comptime]
    match &inputs.slopes {
        ComptimeOption::Some(slopes) => {
            let at = select(inside, 2 * index, 0usize);
            ComptimeOption::new_Some(Vec2::new(slopes[at], slopes[at + 1]))
        }
        ComptimeOption::None => ComptimeOption::new_None(),
    }
}

/// Compile-time parameters of the stage's kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct KernelShape {
    /// Number of features.
    pub features: usize,
    /// Whether depth is accumulated as one more channel.
    pub depth: bool,
    /// Whether the picture's alpha has a gradient. If not, the gradient of the planes lacks the plane of alpha.
    pub grad_alpha: bool,
}

impl KernelShape {
    pub fn of(features: usize, options: &RenderOptions) -> Self {
        Self { features, depth: options.depth, grad_alpha: true }
    }

    pub const fn channels(&self) -> usize {
        self.features + self.depth as usize
    }

    pub const fn few(&self) -> bool {
        self.channels() <= FEW
    }

    /// Whether a unit has a value of each channel in registers.
    pub const fn held(&self) -> bool {
        self.channels() <= BUCKET
    }

    /// Number of values that the forward pass keeps per pixel and segment: the transmittance before the segment
    /// (negative where the pixel was finished), and the sums of the segment if there are few channels.
    pub const fn kept(&self) -> usize {
        1 + if self.few() { self.channels() } else { 0 }
    }
}

/// Passes a layer at a pixel. Returns its alpha (zero if it does not contribute), and the shares that the bucket's
/// layers so far let through (negative where the pixel is finished) and stop.
///
/// While little is stopped, the share let through is one minus the share stopped. The share stopped is a sum whose
/// roundings are as small as itself, whereas a product of many factors near one takes a rounding of one from each.
#[cube]
pub(super) fn layer(alpha: f32, through: f32, stopped: f32, before: f32, transmittance_min: f32) -> (f32, f32, f32) {
    let stops = fma(alpha, through, stopped);
    // Not a product with `1 − α`, whose rounding is the same for all layers of one faint alpha.
    let next = select(stops < 0.5, 1.0 - stops, fma(-alpha, through, through));
    let shows = alpha > 0.0 && through >= 0.0;
    let finishes = shows && before * next <= transmittance_min;
    let contributes = shows && !finishes;
    (
        select(contributes, alpha, 0.0),
        select(contributes, next, select(finishes, -through, through)),
        select(contributes, stops, stopped),
    )
}

/// Returns the transmittance behind a bucket from the transmittance before it and the shares that the bucket lets through and stops. The
/// result is negative if `before` or `through` is: the pixel was finished before the bucket or within it.
#[cube]
pub(super) fn transmittance_after_bucket(before: f32, through: f32, stopped: f32) -> f32 {
    let left = select(stopped < 0.5, fma(-stopped, before, before), before * through.abs());
    select(before >= 0.0, select(through >= 0.0, left, -left), before)
}

/// Returns the part of the transmittance behind a bucket that rounding took: from the part `lost` before the bucket, and from the
/// arguments and the result `left` of [`transmittance_after_bucket`], neither negative.
///
/// The forward pass adds it at the end of each segment, so that the roundings of thousands of buckets do not add up. Within a
/// segment all passes count with the rounded transmittance, from the one that the trace keeps.
#[cube]
pub(super) fn lost_after_bucket(lost: f32, before: f32, left: f32, through: f32, stopped: f32) -> f32 {
    let rounding = fma(-stopped, before, before - left);
    select(stopped < 0.5, fma(-stopped, lost, lost) + rounding, lost * through)
}

/// Returns `sum + value` and what rounding takes from it, plus `lost`, what it took before (Kahan 1965).
#[cube]
pub(crate) fn add_compensated(sum: f32, lost: f32, value: f32) -> (f32, f32) {
    let change = value + lost;
    let total = sum + change;
    (total, change - (total - sum))
}

/// Returns the first slot of a tile's segments. Each started segment has a slot, so no two tiles share one and no list of slots is needed.
#[cube]
pub(super) fn first_slot(first_place: u32, tile: u32) -> u32 {
    first_place / comptime!(SEGMENT as u32) + tile
}
