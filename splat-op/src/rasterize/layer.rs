//! A layer at a pixel, and how places and pixels are dealt out: what the kernels of both passes share, so that the backward
//! pass sees what the forward pass saw.

use cubecl::prelude::*;

use super::power::power;
use crate::intersect::TILE;
use crate::project::COLUMNS;

/// Places of a bucket.
pub(super) const BUCKET: usize = 32;

/// Channels up to which colours go through shared memory and sums through registers, and the trace keeps the sums of each
/// bucket; above, all three would not fit.
pub(super) const FEW: usize = 4;

/// Numbers of a [`LayerEllipse`].
pub(super) const FOOTPRINT: usize = 6;

/// Thresholds of the render besides the frame's.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Limits {
    pub alpha_max: f32,
    /// Below zero for none.
    pub transmittance_min: f32,
}

/// What a kernel of this stage is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct KernelShape {
    /// Features.
    pub features: usize,
    /// Whether depth is accumulated, as a further channel.
    pub depth: bool,
    /// Whether the picture's alpha has a gradient. Where it has none, its plane is missing in the planes' gradient.
    pub grad_alpha: bool,
    /// Whether `exp` is a polynomial, or the device's own.
    pub polynomial: bool,
}

impl KernelShape {
    pub const fn channels(&self) -> usize {
        self.features + self.depth as usize
    }

    pub const fn few(&self) -> bool {
        self.channels() <= FEW
    }

    /// Numbers per pixel and bucket that the forward pass keeps: the transmittance before the bucket (negative where the
    /// pixel was finished), the share that the bucket lets through, and its sums if there are few channels.
    pub const fn kept(&self) -> usize {
        2 + if self.few() { self.channels() } else { 0 }
    }
}

/// Column and row in the tile of the first pixel of a unit, whose pixels are a strip: `rows` of a column. They share `u` and what is
/// read of a Gaussian.
#[cube]
pub(super) fn strip_origin(unit: u32, #[comptime] rows: usize) -> (u32, u32) {
    (unit % comptime!(TILE as u32), unit / comptime!(TILE as u32) * comptime!(rows as u32))
}

/// An ellipse as the pixels' loop reads it.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct LayerEllipse {
    pub x: f32,
    pub y: f32,
    pub inverse_u: f32,
    pub inverse_v: f32,
    pub shear: f32,
    pub opacity: f32,
}

#[cube]
impl LayerEllipse {
    /// Of a row of the packed ellipses.
    pub fn of(projected: &[f32], gaussian: usize) -> LayerEllipse {
        let at = gaussian * comptime!(COLUMNS);
        LayerEllipse {
            x: projected[at],
            y: projected[at + 1],
            inverse_u: 1.0 / projected[at + 2],
            inverse_v: 1.0 / projected[at + 4],
            shear: projected[at + 3],
            opacity: projected[at + 6],
        }
    }

    /// One that shows in no pixel.
    pub fn nowhere() -> LayerEllipse {
        LayerEllipse { x: 0.0, y: 0.0, inverse_u: 0.0, inverse_v: 0.0, shear: 0.0, opacity: 0.0 }
    }

    pub fn store(&self, to: &mut Shared<[f32]>, index: usize) {
        let at = index * comptime!(FOOTPRINT);
        to[at] = self.x;
        to[at + 1] = self.y;
        to[at + 2] = self.inverse_u;
        to[at + 3] = self.inverse_v;
        to[at + 4] = self.shear;
        to[at + 5] = self.opacity;
    }

    pub fn load(from: &Shared<[f32]>, index: usize) -> LayerEllipse {
        let at = index * comptime!(FOOTPRINT);
        LayerEllipse {
            x: from[at],
            y: from[at + 1],
            inverse_u: from[at + 2],
            inverse_v: from[at + 3],
            shear: from[at + 4],
            opacity: from[at + 5],
        }
    }

    /// `u` in the column at `x` px, and how far its pixel in the tile's first row, at `top` px, lies below the ellipse's axis
    /// there, px: in a row further down, by so much more. Times `inverse_v` that is `v`. Small numbers are added to a
    /// distance, never to a coordinate, whose digits are coarser; and as every kernel counts from the tile's first row,
    /// whatever its units' pixels are, all round alike.
    pub fn along_column(&self, x: f32, top: f32) -> (f32, f32) {
        let dx = x - self.x;
        (dx * self.inverse_u, (top - self.y) - self.shear * dx)
    }

    /// `u, v` of the pixel in the column at `x` px, `row` rows below the tile's first one at `top` px.
    pub fn whiten(&self, x: f32, top: f32, row: f32) -> (f32, f32) {
        let (u, below) = self.along_column(x, top);
        (u, (below + row) * self.inverse_v)
    }

    /// The alpha at whitened coordinates; zero where it does not show.
    pub fn alpha(&self, u: f32, v: f32, alpha_min: f32, alpha_max: f32, #[comptime] shape: KernelShape) -> f32 {
        let exponent = -(0.5 * (u * u + v * v));
        let share =
            if comptime!(shape.polynomial) { power(-exponent * core::f32::consts::LOG2_E) } else { exponent.exp() };
        let value = min(self.opacity * share, alpha_max);
        select(value >= alpha_min, value, 0.0)
    }
}

/// Passes a layer at a pixel: its alpha, zero if it does not contribute, and what the bucket's layers so far let through,
/// negative where the pixel is finished, and stop.
///
/// While little is stopped, what is let through is the rest of one: what has been stopped is a sum whose roundings are as
/// small as it is, where the product of many factors next to one takes a rounding of one from each.
#[cube]
pub(super) fn layer(alpha: f32, through: f32, stopped: f32, before: f32, transmittance_min: f32) -> (f32, f32, f32) {
    let stops = fma(alpha, through, stopped);
    // Not times `1 − α`, which is rounded, for all layers of one faint alpha the same way.
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

/// What [`layer`] goes on from, in one number: what is stopped while that is little, else what is let through, negated; two
/// where the pixel is finished.
#[cube]
pub(super) fn checkpoint(through: f32, stopped: f32) -> f32 {
    // A zero has to keep its sign in comparisons.
    let open = select(stopped < 0.5, stopped, -max(through, f32::MIN_POSITIVE));
    select(through >= 0.0, open, 2.0)
}

/// What is let through and stopped at a checkpoint.
#[cube]
pub(super) fn restore(checkpoint: f32) -> (f32, f32) {
    let faint = checkpoint >= 0.0;
    let through = select(faint, 1.0 - checkpoint, -checkpoint);
    (select(checkpoint >= 1.0, -1.0f32, through), select(faint, checkpoint, 1.0))
}

/// The transmittance behind a bucket from that before it and what the bucket lets through and stops. Negative if either of
/// the former two is: the pixel was finished before the bucket or within.
#[cube]
pub(super) fn transmittance_after_bucket(before: f32, through: f32, stopped: f32) -> f32 {
    let left = select(stopped < 0.5, fma(-stopped, before, before), before * through.abs());
    select(before >= 0.0, select(through >= 0.0, left, -left), before)
}

/// The first slot of a tile's buckets: a slot per started bucket, so that no two tiles share one and no list of slots
/// is needed.
#[cube]
pub(super) fn first_bucket(first_place: u32, tile: u32) -> u32 {
    first_place / comptime!(BUCKET as u32) + tile
}

/// Channel `channel` of a Gaussian, the depth after the features.
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
