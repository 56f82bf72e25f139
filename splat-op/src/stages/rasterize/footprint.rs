//! The affine ellipse in the CPU twin.

use fearless_simd::prelude::*;

use super::Layers;
use super::pixels::{TilePixels, lanes, len};
use super::splat_cpu::{Footprint, FootprintLanes, FootprintView, PairSums, SplatAt};
use super::tile_blocks::{SIMD_BLOCKS, TileBlocks};
use crate::intersect::TILE_SIZE;
use crate::intersect::extent::{half_extent, widened_limit};
use crate::project::{self, Ellipse};
use crate::simd::each;
use crate::simd::real::Real;

/// `√(log₂e / 2)`. In whitened coordinates scaled by it, a Gaussian is `2^−(u² + v²)`.
pub(crate) const WHITEN: f64 = 0.849_321_800_288_019_1;

/// Inverse of [`WHITEN`]. It takes the scale out of a sum again, once for each scaled factor of its terms.
const UNWHITEN: f64 = 1.0 / WHITEN;

/// An ellipse in the form that the loop over pixels multiplies by.
#[derive(Clone, Copy, Default)]
pub(crate) struct EllipseFootprint<F> {
    mean_px: [F; 2],
    /// Scaled by [`WHITEN`], like `inverse_v`.
    inverse_u: F,
    inverse_v: F,
    shear: F,
    opacity: F,
    /// Largest `u² + v²`: beyond it the alpha is certainly below `alpha_min`, or not a number.
    extent: F,
    /// [`Self::extent`] with a margin for the rounding of [`Self::met`].
    bound: F,
    /// The least `u² + v²` at an offset `dy` from the mean is at `dx = slope dy`.
    slope: F,
}

impl<F: Real> Footprint<F> for EllipseFootprint<F> {
    const EXTRA_COLUMNS: usize = 0;
    const ALONG_RAYS: bool = false;
    const UNSCALE: f64 = UNWHITEN;
    type Broadcast<S: Simd> = EllipseLanes<S, F>;

    fn read(inputs: &Layers<&[F]>, i: usize, view: &FootprintView<F>) -> Self {
        let ellipse = Ellipse::from_row(&inputs.projected[i * project::COLUMNS..][..project::COLUMNS]);
        // Only Gaussians in the lists are read, and those have a positive opacity.
        if !(ellipse.opacity > F::ZERO) {
            return Self::default();
        }
        let limit = widened_limit(ellipse.opacity, F::of(view.spec.options.alpha_min));
        let extent = (limit * F::of(WHITEN * WHITEN)).min_of(F::EXP2_MAX);
        let (inverse_u, inverse_v) = (F::of(WHITEN) / ellipse.sigma_u, F::of(WHITEN) / ellipse.sigma_v);
        // With `p = shear sigma_u / sigma_v` the slope is `p / (1 + p²)` times `sigma_u / sigma_v`; both parts of the fraction are
        // divided by the larger of 1 and `p`.
        let ratio = inverse_v / inverse_u;
        let p = ellipse.shear * ratio;
        let scale = F::ONE / p.abs().max_of(F::ONE);
        let scaled = p * scale;
        let slope = ratio * scale * scaled / (scale * scale + scaled * scaled);
        // The largest offsets, px, in a tile that the ellipse meets. They bound the rounding of `u` and `v`.
        let [far_x, far_y] = half_extent(&ellipse, limit).map(|half| half + F::of(2.0 * TILE_SIZE as f64));
        let far_v = far_y + ellipse.shear.abs() * far_x;
        let slip = F::of(8.0) * F::EPSILON * (far_x * inverse_u + far_v * inverse_v);
        let reach = extent.sqrt() + slip;
        let bound = if slope.finite() && reach.finite() { reach * reach } else { F::MAX };
        let (shear, opacity) = (ellipse.shear, ellipse.opacity);
        Self { mean_px: ellipse.mean_px, inverse_u, inverse_v, shear, opacity, extent, bound, slope }
    }

    /// The least `u² + v²` over a rectangle lies on a side that faces the ellipse's centre, or is zero if it holds the centre. On a side
    /// it is the least value of a parabola. Both sides nearest to the centre are tried, whether they face it or not.
    #[inline(always)]
    fn met<S: Simd>(&self, simd: S, blocks: &TileBlocks<F>) -> u16 {
        let splat = |value| F::Block::<S>::splat(simd, value);
        let [mean_x, mean_y] = each!(self.mean_px, |px| splat(px));
        let (zero, shear, slope, bound) = (splat(F::ZERO), splat(self.shear), splat(self.slope), splat(self.bound));
        let mut met = 0;
        for block in (0..SIMD_BLOCKS).step_by(len::<S, F>()) {
            let [left, top] = each!([0, 1], |axis| lanes::<S, F>(simd, &blocks.first[axis], block));
            let [right, bottom] = each!([0, 1], |axis| lanes::<S, F>(simd, &blocks.last[axis], block));
            let ([left, right], [top, bottom]) = ([left - mean_x, right - mean_x], [top - mean_y, bottom - mean_y]);
            let (near_x, near_y) = (zero.max(left).min(right), zero.max(top).min(bottom));
            let sides =
                [[near_x, (shear * near_x).max(top).min(bottom)], [(slope * near_y).max(left).min(right), near_y]];
            let [beside, above] = each!(sides, |[dx, dy]| {
                let u = dx * splat(self.inverse_u);
                let v = (-shear).mul_add(dx, dy) * splat(self.inverse_v);
                v.mul_add(v, u * u)
            });
            met |= ((beside.simd_le(bound) | above.simd_le(bound)).to_bitmask() as u16) << block;
        }
        met
    }

    #[inline(always)]
    fn lanes<S: Simd>(&self, simd: S, top: F) -> EllipseLanes<S, F> {
        let lanes = |value| F::Block::<S>::splat(simd, value);
        EllipseLanes {
            mean_x: lanes(self.mean_px[0]),
            rise: lanes(top + F::of(0.5) - self.mean_px[1]),
            inverse_u: lanes(self.inverse_u),
            inverse_v: lanes(self.inverse_v),
            shear: lanes(self.shear),
            slope: lanes(self.inverse_v * self.shear),
            opacity: lanes(self.opacity),
            extent: lanes(self.extent),
        }
    }
}

/// An ellipse's constants for a tile.
pub(crate) struct EllipseLanes<S: Simd, F: Real> {
    mean_x: F::Block<S>,
    /// Offset along y of the centres of the tile's first row from the mean, px.
    rise: F::Block<S>,
    inverse_u: F::Block<S>,
    inverse_v: F::Block<S>,
    shear: F::Block<S>,
    /// `inverse_v` times the shear.
    slope: F::Block<S>,
    opacity: F::Block<S>,
    extent: F::Block<S>,
}

/// Values of an ellipse at a vector of pixels that do not depend on their rows.
pub(crate) struct EllipseColumn<S: Simd, F: Real> {
    /// Scaled by [`WHITEN`].
    u: F::Block<S>,
    /// `u²`
    square: F::Block<S>,
    dx: F::Block<S>,
}

impl<S: Simd, F: Real> FootprintLanes<S, F> for EllipseLanes<S, F> {
    type Column = EllipseColumn<S, F>;
    /// `u` and `v`, scaled by [`WHITEN`].
    type Point = [F::Block<S>; 2];

    #[inline(always)]
    fn opacity(&self) -> F::Block<S> {
        self.opacity
    }

    #[inline(always)]
    fn column(&self, x: F::Block<S>) -> EllipseColumn<S, F> {
        let dx = x - self.mean_x;
        let u = dx * self.inverse_u;
        EllipseColumn { dx, u, square: u * u }
    }

    #[inline(always)]
    fn at(&self, column: &EllipseColumn<S, F>, pixels: &TilePixels<F>, place: usize) -> SplatAt<S, F, Self::Point> {
        let row = pixels.rows(self.mean_x.token(), place);
        // The sum comes before the scaling, so that `v` is exactly zero at the mean.
        let v = (-self.shear).mul_add(column.dx, self.rise + row) * self.inverse_v;
        let exponent = v.mul_add(v, column.square);
        SplatAt { exponent, near: exponent.simd_le(self.extent), depth_factor: exponent, point: [column.u, v] }
    }

    #[inline(always)]
    fn add(
        &self,
        sums: &mut PairSums<S, F>,
        [u, v]: &[F::Block<S>; 2],
        h: F::Block<S>,
        _: Option<F::Block<S>>,
        absolute: bool,
    ) {
        let (u, v) = (*u, *v);
        let (hu, hv) = (h * u, h * v);
        let moments = &mut sums.moments;
        moments[0] += h;
        moments[1] += hu;
        moments[2] += hv;
        moments[3] = hu.mul_add(u, moments[3]);
        moments[4] = hu.mul_add(v, moments[4]);
        moments[5] = hv.mul_add(v, moments[5]);
        if absolute {
            sums.absolute[0] += (hu * self.inverse_u - hv * self.slope).abs();
            sums.absolute[1] += (hv * self.inverse_v).abs();
        }
    }
}

#[cfg(test)]
mod tests;
