//! Functions that the kernels of both passes share, so that the backward pass sees the values of the forward pass: the
//! arithmetic of a layer at a pixel, and the numbering of buckets and segments.

use cubecl::prelude::*;

use crate::gpu::math::Vec3;
use crate::intersect::TILE;
use crate::options::RenderOptions;
use crate::project::COLUMNS;

/// Number of places in a bucket. Within a bucket the transmittance of a pixel is relative to that before it, and one
/// word says which places a block of pixels evaluates.
pub(super) const BUCKET: usize = 32;

/// Number of buckets in a segment.
pub(super) const BUCKETS: usize = 4;

/// Number of places in a segment. The trace keeps a few values per pixel of a segment, which do not depend on any other
/// segment, so the backward pass can process all segments at once.
pub(super) const SEGMENT: usize = BUCKETS * BUCKET;

/// Largest number of channels for which colours go through shared memory, sums go through registers, and the trace
/// keeps the sums of each segment. With more channels, all three would not fit.
pub(crate) const FEW: usize = 4;

/// Four numbers that are read from shared memory at once.
pub(super) type Four = Vector<f32, Const<4>>;

/// Number of vectors of four that a [`LayerEllipse`] takes in shared memory.
pub(super) const FOOTPRINT: usize = 2;

/// The least normal f32. Devices may take smaller numbers for zero.
const SMALLEST: f32 = f32::MIN_POSITIVE;

/// Size of the picture in pixels, its tiles along x, and thresholds of the render.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
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
#[expand(derive(Clone, Copy))]
pub(crate) struct TilePixel {
    /// Centre of its column and of the tile's first row, px, and its row within the tile.
    pub x: f32,
    pub top: f32,
    pub row: f32,
    /// Whether it is in the picture, and its index there.
    pub inside: bool,
    pub index: usize,
}

/// Returns the column and row of a tile's first pixel.
#[cube]
pub(crate) fn tile_origin(tile: u32, frame: &RasterFrame) -> (u32, u32) {
    (tile % frame.tiles_x * comptime!(TILE as u32), tile / frame.tiles_x * comptime!(TILE as u32))
}

#[cube]
impl TilePixel {
    /// Returns pixel `in_tile`, counted row by row, of the tile at `origin`.
    pub fn of(origin: (u32, u32), in_tile: u32, frame: &RasterFrame) -> TilePixel {
        let (first_column, first_row) = origin;
        let column = first_column + in_tile % comptime!(TILE as u32);
        let row = in_tile / comptime!(TILE as u32);
        TilePixel {
            x: f32::cast_from(column) + 0.5,
            top: f32::cast_from(first_row) + 0.5,
            row: f32::cast_from(row),
            inside: column < frame.width && first_row + row < frame.height,
            index: ((first_row + row) * frame.width + column) as usize,
        }
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

    /// Number of values that the forward pass keeps per pixel and segment: the transmittance before the segment
    /// (negative where the pixel was finished), and the sums of the segment if there are few channels.
    pub const fn kept(&self) -> usize {
        1 + if self.few() { self.channels() } else { 0 }
    }
}

/// An ellipse in the form that the loop over a tile's pixels reads.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct LayerEllipse {
    pub x: f32,
    /// Distance, px, by which the centres of the tile's first row lie below the ellipse's centre.
    pub rise: f32,
    pub inverse_u: f32,
    pub inverse_v: f32,
    pub shear: f32,
    pub opacity: f32,
}

#[cube]
impl LayerEllipse {
    /// Reads the ellipse from row `gaussian` of the packed ellipses, for the tile whose first row has its centres at
    /// `top` px. An ellipse with an undefined or infinite number, or whose reciprocal of `sigma_v` vanishes, becomes one
    /// that does not show. All others have a defined alpha everywhere.
    pub fn of(projected: &[f32], gaussian: usize, top: f32) -> LayerEllipse {
        let at = gaussian * comptime!(COLUMNS);
        let x = projected[at];
        let rise = top - projected[at + 1];
        let inverse_u = 1.0 / projected[at + 2];
        let inverse_v = 1.0 / projected[at + 4];
        let shear = projected[at + 3];
        let opacity = projected[at + 6];
        let known = Vec3::new(x, rise, shear).is_finite()
            && Vec3::new(inverse_u, inverse_v, opacity).is_finite()
            && inverse_v >= SMALLEST;
        LayerEllipse {
            x: select(known, x, 0.0),
            rise: select(known, rise, 0.0),
            inverse_u: select(known, inverse_u, 0.0),
            inverse_v: select(known, inverse_v, 0.0),
            shear: select(known, shear, 0.0),
            opacity: select(known, opacity, 0.0),
        }
    }

    pub fn store(&self, to: &mut Shared<[Four]>, index: usize) {
        let mut place = Four::empty();
        place.insert(0usize, self.x);
        place.insert(1usize, self.rise);
        place.insert(2usize, self.inverse_u);
        place.insert(3usize, self.inverse_v);
        let mut rest = Four::empty();
        rest.insert(0usize, self.shear);
        rest.insert(1usize, self.opacity);
        rest.insert(2usize, 0.0f32);
        rest.insert(3usize, 0.0f32);
        to[index * comptime!(FOOTPRINT)] = place;
        to[index * comptime!(FOOTPRINT) + 1] = rest;
    }

    pub fn load(from: &Shared<[Four]>, index: usize) -> LayerEllipse {
        let place = from[index * comptime!(FOOTPRINT)];
        let rest = from[index * comptime!(FOOTPRINT) + 1];
        LayerEllipse {
            x: place.extract(0usize),
            rise: place.extract(1usize),
            inverse_u: place.extract(2usize),
            inverse_v: place.extract(3usize),
            shear: rest.extract(0usize),
            opacity: rest.extract(1usize),
        }
    }

    /// Returns `u` in the column at `x` px, and the distance, px, by which the column's pixel in the tile's first row
    /// lies below the ellipse's axis. For a lower row, its number is added to the distance. The distance times
    /// `inverse_v` is `v`.
    ///
    /// The row number is added to a distance, never to a coordinate, whose digits are coarser.
    pub fn along_column(&self, x: f32) -> (f32, f32) {
        let dx = x - self.x;
        (dx * self.inverse_u, fma(-self.shear, dx, self.rise))
    }

    /// Returns the alpha at the pixel in the column at `x` px, `row` rows below the tile's first; zero where it is below
    /// `alpha_min`.
    ///
    /// Every kernel takes its alphas from here. Products that are added are written as `fma`, so that no compiler can
    /// choose whether to round them, and all kernels see the same bits.
    pub fn alpha(&self, x: f32, row: f32, frame: &RasterFrame) -> f32 {
        let (u, below) = self.along_column(x);
        let v = (below + row) * self.inverse_v;
        let square = fma(u, u, v * v);
        let share = (square * -0.5f32).exp();
        let value = min(self.opacity * share, frame.alpha_max);
        select(value >= frame.alpha_min, value, 0.0)
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

/// Returns the transmittance behind a bucket from the transmittance before it and the shares that the bucket lets
/// through and stops. The result is negative if `before` or `through` is: the pixel was finished before the bucket or
/// within it.
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

/// Returns the first slot of a tile's segments. Each started segment has a slot, so no two tiles share one and no list
/// of slots is needed.
#[cube]
pub(super) fn first_slot(first_place: u32, tile: u32) -> u32 {
    first_place / comptime!(SEGMENT as u32) + tile
}

/// Returns channel `channel` of a Gaussian; depth follows the features.
#[cube]
pub(super) fn colour(
    projected: &[f32],
    features: &[f32],
    gaussian: usize,
    channel: usize,
    #[comptime] shape: KernelShape,
) -> f32 {
    let is_depth = comptime!(shape.depth) && channel == comptime!(shape.features);
    let mut value = 0.0f32;
    if is_depth {
        value = projected[gaussian * comptime!(COLUMNS) + 5];
    }
    if !is_depth {
        value = features[gaussian * comptime!(shape.features) + channel];
    }
    value
}

/// Returns all channels of a Gaussian, of at most [`FEW`].
#[cube]
pub(super) fn colours_of(projected: &[f32], features: &[f32], gaussian: usize, #[comptime] shape: KernelShape) -> Four {
    let mut all = Four::empty();
    #[unroll]
    for channel in 0..comptime!(FEW) {
        let mut value = 0.0f32;
        if comptime!(channel < shape.channels()) {
            value = colour(projected, features, gaussian, channel, shape);
        }
        all.insert(channel, value);
    }
    all
}
