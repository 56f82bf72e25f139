//! A layer at a pixel, and how places and pixels are dealt out: what the kernels of both passes share, so that the backward
//! pass sees what the forward pass saw.

use cubecl::prelude::*;

use crate::project::COLUMNS;
use crate::tile::TILE;

/// Places of a bucket.
pub(super) const BUCKET: usize = 32;

/// Channels up to which colours go through shared memory and sums through registers, and the trace keeps the sums of each
/// bucket; above, all three would not fit.
pub(super) const FEW: usize = 4;

/// Numbers of an ellipse in shared memory.
pub(super) const FOOTPRINT: usize = 7;

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
pub(crate) struct Shape {
    /// Features.
    pub features: usize,
    /// Whether depth is accumulated, as a further channel.
    pub depth: bool,
}

impl Shape {
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

/// The pixels of a unit: some columns of a tile, and of those a block of rows. Pixels in one column share `u`, and all
/// share what is read of a Gaussian. A graphics card has units to fill, and hides the reading behind them. A software
/// driver runs eight units at a time as one vector, and reads for each of them one after the other, ten times slower than
/// it computes: there a strip is as long as eight units leave it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Strip {
    /// Columns of a unit.
    pub across: usize,
    /// Blocks that the rows of a tile are cut into.
    pub blocks: usize,
}

impl Strip {
    pub const fn units(&self) -> usize {
        TILE / self.across * self.blocks
    }

    pub const fn rows(&self) -> usize {
        TILE / self.blocks
    }

    pub const fn pixels(&self) -> usize {
        self.across * self.rows()
    }
}

/// Column and row in the tile of a unit's first pixel.
#[cube]
pub(super) fn strip_origin(#[comptime] strip: Strip) -> (u32, u32) {
    let along = comptime!((TILE / strip.across) as u32);
    (UNIT_POS % along * comptime!(strip.across as u32), UNIT_POS / along * comptime!(strip.rows() as u32))
}

/// An ellipse as the pixels' loop reads it.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Footprint {
    pub x: f32,
    pub y: f32,
    pub inverse_u: f32,
    pub inverse_v: f32,
    pub shear: f32,
    pub opacity: f32,
    /// Exponents below this give an alpha below `alpha_min` for certain.
    pub exponent_min: f32,
}

#[cube]
impl Footprint {
    /// Of a row of the packed ellipses.
    pub fn of(projected: &[f32], gaussian: usize, alpha_min: f32) -> Footprint {
        let at = gaussian * comptime!(COLUMNS);
        let opacity = projected[at + 6];
        let mut exponent_min = f32::min_value();
        if alpha_min > 0.0 {
            // A relative margin for the logarithm, an absolute one for the exponential.
            exponent_min = (alpha_min / opacity).ln() * 1.00001 - 5e-5;
        }
        Footprint {
            x: projected[at],
            y: projected[at + 1],
            inverse_u: 1.0 / projected[at + 2],
            inverse_v: 1.0 / projected[at + 4],
            shear: projected[at + 3],
            opacity,
            exponent_min,
        }
    }

    /// One that shows in no pixel.
    pub fn nowhere() -> Footprint {
        Footprint { x: 0.0, y: 0.0, inverse_u: 0.0, inverse_v: 0.0, shear: 0.0, opacity: 0.0, exponent_min: 1.0 }
    }

    pub fn store(&self, to: &mut Shared<[f32]>, index: usize) {
        let at = index * comptime!(FOOTPRINT);
        to[at] = self.x;
        to[at + 1] = self.y;
        to[at + 2] = self.inverse_u;
        to[at + 3] = self.inverse_v;
        to[at + 4] = self.shear;
        to[at + 5] = self.opacity;
        to[at + 6] = self.exponent_min;
    }

    pub fn load(from: &Shared<[f32]>, index: usize) -> Footprint {
        let at = index * comptime!(FOOTPRINT);
        Footprint {
            x: from[at],
            y: from[at + 1],
            inverse_u: from[at + 2],
            inverse_v: from[at + 3],
            shear: from[at + 4],
            opacity: from[at + 5],
            exponent_min: from[at + 6],
        }
    }

    /// `u` in the column at `x` px, and how far its pixel at `y` px lies below the ellipse's axis there, px: in a row further
    /// down, by so much more. Times `inverse_v` that is `v`. Small numbers are added to a distance, never to a coordinate,
    /// whose digits are coarser.
    pub fn along_column(&self, x: f32, y: f32) -> (f32, f32) {
        let dx = x - self.x;
        (dx * self.inverse_u, (y - self.y) - self.shear * dx)
    }

    /// `u, v` of a pixel with its centre at `x, y` px.
    pub fn whiten(&self, x: f32, y: f32) -> (f32, f32) {
        let dx = x - self.x;
        let dy = y - self.y;
        (dx * self.inverse_u, (dy - self.shear * dx) * self.inverse_v)
    }

    /// The alpha at whitened coordinates; zero where it does not show.
    pub fn alpha(&self, u: f32, v: f32, alpha_min: f32, alpha_max: f32) -> f32 {
        let exponent = -(0.5 * (u * u + v * v));
        let value = min(self.opacity * exponent.exp(), alpha_max);
        select(exponent >= self.exponent_min && value >= alpha_min, value, 0.0)
    }
}

/// Passes a layer at a pixel: its alpha, zero if it does not contribute, and what is let through behind it relative to the
/// bucket; negative where the pixel is finished.
#[cube]
pub(super) fn layer(alpha: f32, through: f32, before: f32, transmittance_min: f32) -> (f32, f32) {
    // Not times `1 − α`, which is rounded, for all layers of one faint alpha the same way.
    let next = fma(-alpha, through, through);
    let shows = alpha > 0.0 && through >= 0.0;
    let finishes = shows && before * next <= transmittance_min;
    let contributes = shows && !finishes;
    (select(contributes, alpha, 0.0), select(contributes, next, select(finishes, -through, through)))
}

/// The first slot of a tile's buckets: a slot per started 32 places, so that no two tiles share one and no list of slots
/// is needed.
#[cube]
pub(super) fn first_slot(first_place: u32, tile: u32) -> u32 {
    first_place / comptime!(BUCKET as u32) + tile
}

/// Channel `channel` of a Gaussian, the depth after the features.
#[cube]
pub(super) fn colour(
    projected: &[f32],
    features: &[f32],
    gaussian: usize,
    channel: usize,
    #[comptime] shape: Shape,
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
