//! A layer at a pixel, and how places and pixels are dealt out: what the kernels of both passes share, so that the backward
//! pass sees what the forward pass saw.

use cubecl::prelude::*;

use super::half::load_half;
use super::power::power;
use crate::gpu::math::within;
use crate::project::COLUMNS;
use crate::tile::TILE;

/// Places of a bucket of [`Shape::bucket`] where a plane of units works on it together.
pub(super) const BUCKET: usize = 32;

/// Channels up to which colours go through shared memory and sums through registers, and the trace keeps the sums of each
/// bucket; above, all three would not fit.
pub(super) const FEW: usize = 4;

/// Numbers of a [`Footprint`].
pub(super) const FOOTPRINT: usize = 6;

/// The columns of a packed ellipse that they come from: `mean2d, sigma_u, sigma_v, shear, opacity`.
const NUMBERS: [usize; FOOTPRINT] = [0, 1, 2, 4, 3, 6];

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
    /// Places of a bucket.
    pub bucket: usize,
    /// Whether the picture's alpha has a gradient. Where it has none, its plane is missing in the planes' gradient.
    pub grad_alpha: bool,
    /// Whether `exp` is a polynomial, or the device's own.
    pub polynomial: bool,
    /// Whether features are stored in half precision.
    pub half: bool,
}

impl Shape {
    pub const fn channels(&self) -> usize {
        self.features + self.depth as usize
    }

    pub const fn few(&self) -> bool {
        self.channels() <= FEW
    }

    /// Planes of the gradient that a pixel has, one behind the other.
    pub const fn gradients(&self) -> usize {
        self.channels() + self.grad_alpha as usize
    }

    /// Numbers per pixel and bucket that the forward pass keeps: the transmittance before the bucket (negative where the
    /// pixel was finished), the share that the bucket lets through, and its sums if there are few channels.
    pub const fn kept(&self) -> usize {
        2 + if self.few() { self.channels() } else { 0 }
    }
}

/// The pixels of a unit: a block of a tile. Pixels in one column share `u`, and all share what is read of a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Block {
    /// Columns and rows.
    pub across: usize,
    pub down: usize,
}

impl Block {
    /// Blocks of a tile along a row.
    pub const fn along(&self) -> usize {
        TILE / self.across
    }

    /// Blocks of a tile.
    pub const fn of_tile(&self) -> usize {
        self.along() * (TILE / self.down)
    }

    pub const fn pixels(&self) -> usize {
        self.across * self.down
    }

    /// Column and row of pixel `p`, down one column after the other.
    pub const fn pixel(&self, p: usize) -> [usize; 2] {
        [p / self.down, p % self.down]
    }

    /// Where pixel `p` lies from the block's first one, in planes of a tile's pixels.
    pub const fn in_tile(&self, p: usize) -> usize {
        p % self.down * TILE + p / self.down
    }
}

/// Column and row in the tile of the first pixel of a block.
#[cube]
pub(super) fn block_origin(index: u32, #[comptime] block: Block) -> (u32, u32) {
    let along = comptime!(block.along() as u32);
    (index % along * comptime!(block.across as u32), index / along * comptime!(block.down as u32))
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
}

#[cube]
impl Footprint {
    /// Of a row of the packed ellipses.
    pub fn of(projected: &[f32], gaussian: usize) -> Footprint {
        Footprint {
            x: Footprint::number(projected, gaussian, 0usize),
            y: Footprint::number(projected, gaussian, 1usize),
            inverse_u: Footprint::number(projected, gaussian, 2usize),
            inverse_v: Footprint::number(projected, gaussian, 3usize),
            shear: Footprint::number(projected, gaussian, 4usize),
            opacity: Footprint::number(projected, gaussian, 5usize),
        }
    }

    /// One that shows in no pixel.
    pub fn nowhere() -> Footprint {
        Footprint { x: 0.0, y: 0.0, inverse_u: 0.0, inverse_v: 0.0, shear: 0.0, opacity: 0.0 }
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

    pub fn load(from: &Shared<[f32]>, index: usize) -> Footprint {
        let at = index * comptime!(FOOTPRINT);
        Footprint {
            x: from[at],
            y: from[at + 1],
            inverse_u: from[at + 2],
            inverse_v: from[at + 3],
            shear: from[at + 4],
            opacity: from[at + 5],
        }
    }

    /// Number `number` of a row of the packed ellipses, in the order of the fields.
    pub fn number(projected: &[f32], gaussian: usize, #[comptime] number: usize) -> f32 {
        let value = projected[gaussian * comptime!(COLUMNS) + comptime!(NUMBERS[number])];
        if comptime!(number == 2 || number == 3) { 1.0 / value } else { value }
    }

    /// Of arrays of those numbers.
    pub fn among(numbers: &Sequence<Array<f32>>, index: usize) -> Footprint {
        Footprint {
            x: numbers[0][index],
            y: numbers[1][index],
            inverse_u: numbers[2][index],
            inverse_v: numbers[3][index],
            shear: numbers[4][index],
            opacity: numbers[5][index],
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
    pub fn alpha(&self, u: f32, v: f32, alpha_min: f32, alpha_max: f32, #[comptime] shape: Shape) -> f32 {
        let exponent = -(0.5 * (u * u + v * v));
        let share =
            if comptime!(shape.polynomial) { power(-exponent * core::f32::consts::LOG2_E) } else { exponent.exp() };
        let value = min(self.opacity * share, alpha_max);
        select(value >= alpha_min, value, 0.0)
    }

    /// Which blocks of the tile whose first pixel has its centre at `x, y` px the ellipse may show in, a bit each. Those left
    /// out hold no pixel with an alpha of at least `alpha_min`: the ellipse of that alpha has the half-axes
    /// `r sigma_u` and `r √(sigma_v² + shear² sigma_u²)` with `r² = 2 ln(opacity/alpha_min)`.
    pub fn blocks_reached(&self, x: f32, y: f32, alpha_min: f32, #[comptime] block: Block) -> u32 {
        let mut reach = f32::max_value();
        if alpha_min > 0.0 {
            // Relative and absolute margins above the rounding of logarithm, exponential and coordinates.
            reach = (2.0002 * max((self.opacity / alpha_min).ln(), 0.0) + 1e-3).sqrt();
        }
        let slope = self.shear * (self.inverse_v / self.inverse_u);
        let half_width = reach / self.inverse_u + 0.01;
        let half_height = reach * (1.0 + slope * slope).sqrt() / self.inverse_v + 0.01;
        let (dx, dy) = (x - self.x, y - self.y);
        let mut columns = 0u32;
        #[unroll]
        for i in 0..comptime!(block.along()) {
            let first = dx + comptime!((i * block.across) as f32);
            if first <= half_width && first + comptime!((block.across - 1) as f32) >= -half_width {
                columns |= comptime!(1u32 << i as u32);
            }
        }
        let mut reached = 0u32;
        #[unroll]
        for i in 0..comptime!(TILE / block.down) {
            let first = dy + comptime!((i * block.down) as f32);
            if first <= half_height && first + comptime!((block.down - 1) as f32) >= -half_height {
                reached |= columns << comptime!((i * block.along()) as u32);
            }
        }
        reached
    }

    /// As [`Self::blocks_reached`], without those of the ellipse's bounding box that the ellipse itself does not meet: by the
    /// least `u² + v²` over a block, which lies at the centre or on a side that faces it, where it is the minimum of a
    /// parabola. For few large blocks; a test takes thirty instructions.
    pub fn blocks_met(&self, x: f32, y: f32, alpha_min: f32, #[comptime] block: Block) -> u32 {
        let reached = self.blocks_reached(x, y, alpha_min, block);
        let mut reach = f32::max_value();
        if alpha_min > 0.0 {
            reach = (2.0002 * max((self.opacity / alpha_min).ln(), 0.0) + 1e-3).sqrt();
        }
        let ratio = self.inverse_u / self.inverse_v;
        let denominator = self.shear * self.shear + ratio * ratio;
        // Where the slope of the axis has no digits, the bounding box decides.
        let sound = denominator > 1e-30 && denominator < 1e30;
        let slope = self.shear / select(sound, denominator, 1.0);
        let mut met = 0u32;
        #[unroll]
        for i in 0..comptime!(block.of_tile()) {
            let left = x - self.x + comptime!((i % block.along() * block.across) as f32);
            let right = left + comptime!((block.across - 1) as f32);
            let top = y - self.y + comptime!((i / block.along() * block.down) as f32);
            let bottom = top + comptime!((block.down - 1) as f32);
            let near_x = within(0.0, left, right);
            let near_y = within(0.0, top, bottom);
            let beside = self.whitened_square(near_x, within(self.shear * near_x, top, bottom));
            let above = self.whitened_square(within(slope * near_y, left, right), near_y);
            let least =
                min(select(near_x != 0.0, beside, f32::max_value()), select(near_y != 0.0, above, f32::max_value()));
            // `dy − shear dx` loses digits when both terms are large; the pixels may then see a smaller value than this.
            let farthest = max(left.abs(), right.abs()) * self.shear.abs() + max(top.abs(), bottom.abs());
            let limit = reach + 1e-6 * farthest * self.inverse_v;
            let inside = near_x == 0.0 && near_y == 0.0;
            if inside || !sound || !(least > limit * limit) {
                met |= comptime!(1u32 << i as u32);
            }
        }
        reached & met
    }

    /// `u² + v²` at an offset from the centre, px.
    fn whitened_square(&self, dx: f32, dy: f32) -> f32 {
        let u = dx * self.inverse_u;
        let v = (dy - self.shear * dx) * self.inverse_v;
        u * u + v * v
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
pub(super) fn behind_bucket(before: f32, through: f32, stopped: f32) -> f32 {
    let left = select(stopped < 0.5, fma(-stopped, before, before), before * through.abs());
    select(before >= 0.0, select(through >= 0.0, left, -left), before)
}

/// The first slot of a tile's buckets: a slot per started bucket, so that no two tiles share one and no list of slots
/// is needed.
#[cube]
pub(super) fn first_slot(first_place: u32, tile: u32, #[comptime] shape: Shape) -> u32 {
    first_place / comptime!(shape.bucket as u32) + tile
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
        value = if comptime!(shape.half) {
            load_half(features, gaussian, channel, shape)
        } else {
            features[gaussian * comptime!(shape.features) + channel]
        };
    }
    value
}
