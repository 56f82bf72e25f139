//! The affine ellipse in the kernels.

use cubecl::prelude::*;

use super::MOMENTS;
use super::blocks::{ACROSS, BLOCK_HEIGHT, BLOCK_WIDTH, HALF_BLOCKS, pixel_of};
use super::layer::{Four, KernelShape, RasterFrame, SplatInputs, TilePixel, four};
use super::splat::{BlockPairs, Splat};
use crate::gpu::math::{Vec3, finite, within};
use crate::intersect::TILE_SIZE;
use crate::project;

/// The least normal f32. Devices may take smaller numbers for zero.
const SMALLEST: f32 = f32::MIN_POSITIVE;

/// Bound of the rounding error of a coordinate, relative to the largest coordinate in its formula: 16 roundings of f32.
const SLIP: f32 = 1e-6;

/// An ellipse in the form that the loop over a tile's pixels reads.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct LayerEllipse {
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
    /// Returns `u` in the column at `x` px, and the distance, px, by which the column's pixel in the tile's first row lies below the
    /// ellipse's axis. For a lower row, its number is added to the distance. The distance times `inverse_v` is `v`.
    ///
    /// The row number is added to a distance, never to a coordinate, whose digits are coarser.
    pub fn along_column(&self, x: f32) -> (f32, f32) {
        let dx = x - self.x;
        (dx * self.inverse_u, fma(-self.shear, dx, self.rise))
    }

    /// Returns the alpha at the pixel in the column at `x` px, `row` rows below the tile's first; zero where it is below `alpha_min`.
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

#[cube]
impl Splat for LayerEllipse {
    const VECTORS: usize = 2;
    const EXTRA_COLUMNS: usize = 0;
    const ALONG_RAYS: bool = false;

    /// An ellipse with an undefined or infinite number, or whose reciprocal of `sigma_v` vanishes, becomes one that does not show.
    /// All others have a defined alpha everywhere.
    fn of(inputs: &SplatInputs, gaussian: usize, top: f32, _frame: &RasterFrame) -> LayerEllipse {
        let at = gaussian * comptime!(project::COLUMNS);
        let x = inputs.projected[at];
        let rise = top - inputs.projected[at + 1];
        let inverse_u = 1.0 / inputs.projected[at + 2];
        let inverse_v = 1.0 / inputs.projected[at + 4];
        let shear = inputs.projected[at + 3];
        let opacity = inputs.projected[at + 6];
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

    fn store(splat: &LayerEllipse, to: &mut Shared<[Four]>, index: usize) {
        to[index * 2] = four(splat.x, splat.rise, splat.inverse_u, splat.inverse_v);
        to[index * 2 + 1] = four(splat.shear, splat.opacity, 0.0, 0.0);
    }

    fn load(from: &Shared<[Four]>, index: usize, _inputs: &SplatInputs) -> LayerEllipse {
        let place = from[index * 2];
        let rest = from[index * 2 + 1];
        LayerEllipse {
            x: place.extract(0usize),
            rise: place.extract(1usize),
            inverse_u: place.extract(2usize),
            inverse_v: place.extract(3usize),
            shear: rest.extract(0usize),
            opacity: rest.extract(1usize),
        }
    }

    fn blocks_met(splat: &LayerEllipse, left: f32, half: u32, frame: &RasterFrame) -> u32 {
        blocks_met(splat, left, half, frame)
    }

    fn seen(splat: &LayerEllipse, pixel: &TilePixel, frame: &RasterFrame) -> (f32, f32) {
        (splat.alpha(pixel.x, pixel.row, frame), 0.0f32.runtime())
    }

    /// Adds the moments, and the sums of absolute values.
    fn add_pairs(
        row: &mut Array<f32>,
        splat: &LayerEllipse,
        pairs: BlockPairs,
        heights: &Shared<[f32]>,
        _weights: &Shared<[f32]>,
        _grad: &[f32],
        inputs: &SplatInputs,
        frame: &RasterFrame,
        #[comptime] shape: KernelShape,
        #[comptime] absolute: bool,
    ) {
        let corner = TilePixel::of(pairs.origin, pixel_of(pairs.first_unit), inputs, frame);
        let slope = splat.inverse_v * splat.shear;
        for column in 0..comptime!(BLOCK_WIDTH as u32) {
            let (u, below) = splat.along_column(corner.x + f32::cast_from(column));
            // Down the column `u` is the same.
            let mut h_sum = 0.0f32;
            let mut hv_sum = 0.0f32;
            let mut hvv_sum = 0.0f32;
            #[unroll]
            for step in 0..comptime!(BLOCK_HEIGHT) {
                let h = heights[pairs.at as usize + column as usize + comptime!(step * BLOCK_WIDTH)];
                let v = (below + (corner.row + comptime!(step as f32))) * splat.inverse_v;
                let hv = h * v;
                h_sum += h;
                hv_sum += hv;
                hvv_sum += hv * v;
                if comptime!(absolute) {
                    row[comptime!(MOMENTS + shape.channels())] += (h * u * splat.inverse_u - hv * slope).abs();
                    row[comptime!(MOMENTS + shape.channels() + 1)] += (hv * splat.inverse_v).abs();
                }
            }
            row[0] += h_sum;
            row[1] += h_sum * u;
            row[2] += hv_sum;
            row[3] += h_sum * u * u;
            row[4] += hv_sum * u;
            row[5] += hvv_sum;
        }
    }
}

/// Returns the blocks in half `half` of a tile whose pixel centres the ellipse `alpha >= alpha_min` meets, one bit each.
/// `left` is the centre of the tile's first column, px. No pixel that would see an alpha is left out.
///
/// The least `u² + v²` over a rectangle lies on a side that faces the ellipse's centre, or is zero if it holds the
/// centre. On a side it is the minimum of a parabola. Both sides nearest to the centre are tried, whether they face it
/// or not: a point of the rectangle has no less than the least.
#[cube]
pub(super) fn blocks_met(ellipse: &LayerEllipse, left: f32, half: u32, frame: &RasterFrame) -> u32 {
    let last = comptime!((TILE_SIZE - 1) as f32);
    let dx = left - ellipse.x;
    let dy = ellipse.rise;
    let farthest_x = max(dx.abs(), (dx + last).abs());
    let farthest_y = fma(farthest_x, ellipse.shear.abs(), max(dy.abs(), (dy + last).abs()));
    // A relative margin for the logarithm, an absolute one for the exponential.
    let limit = fma(max(ellipse.opacity.ln() - frame.log_least, 0.0), 2.00002f32, 1e-4f32);
    let slip = fma(farthest_x, ellipse.inverse_u, farthest_y * ellipse.inverse_v) * SLIP;
    let extent = limit.sqrt() + slip;
    let bound = extent * extent;
    // The minimum on a horizontal side at `dy` lies at `slope dy`. With `p = shear sigma_u / sigma_v` the slope is
    // `p / (1 + p²)` times `sigma_u / sigma_v`; both parts of the fraction are divided by the larger of 1 and `p`.
    let ratio = ellipse.inverse_v / ellipse.inverse_u;
    let p = ellipse.shear * ratio;
    let scale = 1.0 / max(p.abs(), 1.0);
    let scaled = p * scale;
    let slope = ratio * scale * scaled / fma(scale, scale, scaled * scaled);
    let sound =
        finite(slope) && finite(p) && finite(farthest_y) && finite(ellipse.inverse_u) && finite(ellipse.inverse_v);

    let mut met = 0u32;
    #[unroll]
    for block in 0..comptime!(HALF_BLOCKS) {
        let low_x = dx + comptime!((block % ACROSS * BLOCK_WIDTH) as f32);
        let high_x = low_x + comptime!((BLOCK_WIDTH - 1) as f32);
        let row = half * comptime!((TILE_SIZE / 2) as u32) + comptime!((block / ACROSS * BLOCK_HEIGHT) as u32);
        let low_y = dy + f32::cast_from(row);
        let high_y = low_y + comptime!((BLOCK_HEIGHT - 1) as f32);
        let near_x = within(0.0, low_x, high_x);
        let near_y = within(0.0, low_y, high_y);
        let beside = whitened(ellipse, near_x, within(ellipse.shear * near_x, low_y, high_y));
        let above = whitened(ellipse, within(slope * near_y, low_x, high_x), near_y);
        if !sound || beside <= bound || above <= bound {
            met |= comptime!(1u32 << block);
        }
    }
    met
}

/// Returns `u² + v²` at an offset from the ellipse's centre, px.
#[cube]
fn whitened(ellipse: &LayerEllipse, dx: f32, dy: f32) -> f32 {
    let u = dx * ellipse.inverse_u;
    let v = fma(-ellipse.shear, dx, dy) * ellipse.inverse_v;
    fma(u, u, v * v)
}

#[cfg(test)]
mod tests;
