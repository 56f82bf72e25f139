//! A Gaussian along the pixels' rays in the CPU twin.

use fearless_simd::prelude::*;

use super::{D_MIN, WHITENED_MAX};
use crate::intersect::PixelBox;
use crate::intersect::extent::widened_limit;
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::Layers;
use crate::rasterize::footprint::WHITEN;
use crate::rasterize::pixels::{TilePixels, lanes};
use crate::rasterize::splat_cpu::{Footprint, FootprintLanes, FootprintView, PairSums, SplatAt};
use crate::rasterize::tile_blocks::TileBlocks;
use crate::ray_space::{LensFrame, SLOPES, beyond, columns};
use crate::simd::{Real, each};

/// A Gaussian in the form that the loops over pixels multiply by. Nothing is scaled, as it is in `rasterize`: where `s` is a small
/// difference of products, their rounding would show.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
pub(crate) struct RayFootprint<F> {
    /// Origin of the whitened coordinates: the centre, or the point of the picture's border nearest to it, px.
    base_px: [F; 2],
    inverse_u: F,
    inverse_v: F,
    shear: F,
    opacity: F,
    /// Largest exponent: beyond it the alpha is certainly below `alpha_min`. A negative extent never shows.
    extent: F,
    depth_slope: [F; 2],
    /// The square of the thickness.
    thick: F,
    depth: F,
    /// `(α, β)` and `γ`: the centre relative to the origin.
    centre: [F; 2],
    gamma: F,
    /// Whether the centre is not the origin.
    beyond: bool,
    /// The columns of a lens that take the slopes of a ray to its whitened coordinates.
    frame: LensFrame<F>,
    /// Middle and half the size of its box, px.
    bounds: [[f32; 2]; 2],
}

impl<F: Real> Footprint<F> for RayFootprint<F> {
    const EXTRA_COLUMNS: usize = SLOPES;
    const ALONG_RAYS: bool = true;
    const UNSCALE: f64 = 1.0;
    type Broadcast<S: Simd> = RayLanes<S, F>;

    fn read(inputs: &Layers<&[F]>, i: usize, view: &FootprintView<F>) -> Self {
        let FootprintView { spec, lens, boxes } = view;
        let row = &inputs.projected[i * COLUMNS..][..COLUMNS];
        let columns = columns(&spec.intrinsics);
        let slopes = &inputs.ray_space[i * columns..][..columns];
        let (mut ellipse, alpha_min) = (Ellipse::from_row(row), F::of(spec.options.alpha_min));
        if !(ellipse.opacity > F::ZERO && row.iter().chain(slopes).all(|value| value.finite())) {
            return Self { extent: -F::ONE, ..Self::default() };
        }
        let (base_px, _) = beyond(ellipse.mean_px, &spec.intrinsics);
        let (centre_depth, away) = (slopes[3], [slopes[4], slopes[5]]);
        [ellipse.sigma_u, ellipse.shear, ellipse.sigma_v] = [slopes[6], slopes[7], slopes[8]];
        // Limits at which no product of `u`, `v` and `s` overflows anywhere in the picture.
        let widest = F::of(WHITENED_MAX);
        let size = [spec.intrinsics.width, spec.intrinsics.height].map(|px| F::of(px as f64));
        let frame = LensFrame::of(slopes).unwrap_or_default();
        let [far_x, far_y] = [0, 1].map(|axis| {
            let base = base_px[axis];
            let far = base.abs().max_of((size[axis] - base).abs()).max_of(F::ONE);
            lens.as_ref().map_or(far, |lens| far.max_of(frame.farthest(lens, axis)))
        });
        let far_v = far_y + ellipse.shear.abs() * far_x;
        let inverse = |sigma: F, far: F| (F::ONE / sigma).min_of(widest / far);
        let (inverse_u, inverse_v) = (inverse(ellipse.sigma_u, far_x), inverse(ellipse.sigma_v, far_v));
        let slope = |value: F, far: F| {
            let largest = widest * widest / far;
            value.within(-largest, largest)
        };
        let depth_slope = [slope(slopes[0], far_x * inverse_u), slope(slopes[1], far_v * inverse_v)];
        let centre = [away[0] * inverse_u, (away[1] - ellipse.shear * away[0]) * inverse_v];
        let centre = centre.map(|value| value.within(-widest, widest));
        let [by_x, by_y] = frame.by;
        let whitened = [
            each!(by_x, |by| by * inverse_u),
            each!([0, 1], |slope| (by_y[slope] - ellipse.shear * by_x[slope]) * inverse_v),
        ];
        // Lists of another projection may have none.
        let found = boxes.get(i).unwrap_or(&PixelBox::EVERYWHERE);
        let limit = widened_limit(ellipse.opacity, alpha_min) * F::of(WHITEN * WHITEN);
        Self {
            base_px,
            inverse_u,
            inverse_v,
            shear: ellipse.shear,
            opacity: ellipse.opacity,
            extent: limit.min_of(F::EXP2_MAX),
            depth_slope,
            thick: slopes[2] * slopes[2],
            depth: ellipse.depth,
            centre,
            gamma: centre_depth - depth_slope[0] * centre[0] - depth_slope[1] * centre[1],
            beyond: away != [F::ZERO; 2] || centre_depth != F::ONE,
            frame: LensFrame { by: whitened, ..frame },
            bounds: [found.middle, found.half],
        }
    }

    #[inline(always)]
    fn met<S: Simd>(&self, simd: S, blocks: &TileBlocks<F>) -> u16 {
        let [middle, half] = self.bounds.map(|pair| pair.map(|px| F::of(px.into())));
        blocks.met(simd, middle, half)
    }

    #[inline(always)]
    fn lanes<S: Simd>(&self, simd: S, _top: F) -> RayLanes<S, F> {
        let lanes = |value| F::Block::<S>::splat(simd, value);
        RayLanes {
            simd,
            splat: *self,
            base: each!(self.base_px, |px| lanes(px)),
            inverse_u: lanes(self.inverse_u),
            inverse_v: lanes(self.inverse_v),
            shear: lanes(self.shear),
            opacity: lanes(self.opacity),
            extent: lanes(self.extent),
            depth_slope: each!(self.depth_slope, |slope| lanes(slope)),
            thick: lanes(self.thick),
            depth: lanes(self.depth),
            centre: each!(self.centre, |value| lanes(value)),
            gamma: lanes(self.gamma),
        }
    }
}

/// A Gaussian's constants, one copy in each lane.
pub(crate) struct RayLanes<S: Simd, F: Real> {
    simd: S,
    splat: RayFootprint<F>,
    base: [F::Block<S>; 2],
    inverse_u: F::Block<S>,
    inverse_v: F::Block<S>,
    shear: F::Block<S>,
    opacity: F::Block<S>,
    extent: F::Block<S>,
    depth_slope: [F::Block<S>; 2],
    thick: F::Block<S>,
    depth: F::Block<S>,
    centre: [F::Block<S>; 2],
    gamma: F::Block<S>,
}

/// A Gaussian at a vector of pixels, with the names of the module's documentation.
pub(crate) struct RayPoint<S: Simd, F: Real> {
    u: F::Block<S>,
    v: F::Block<S>,
    /// `1/D`, or zero where `λ` is set to zero.
    inverse: F::Block<S>,
    /// `s/D`; `a`, `b` and `c`.
    along: F::Block<S>,
    apart: [F::Block<S>; 3],
}

impl<S: Simd, F: Real> RayLanes<S, F> {
    /// Returns the whitened coordinates of the rays of the vector of pixels at `place`, whose centres along x are `x`, px.
    #[inline(always)]
    fn whitened(&self, x: F::Block<S>, pixels: &TilePixels<F>, place: usize) -> [F::Block<S>; 2] {
        let splat = |value: F| F::Block::<S>::splat(self.simd, value);
        if let Some(slopes) = &pixels.slopes {
            let LensFrame { centre, by } = self.splat.frame;
            let x = lanes::<S, F>(self.simd, &slopes[0], place) - splat(centre[0]);
            let y = lanes::<S, F>(self.simd, &slopes[1], place) - splat(centre[1]);
            each!(by, |[by_x, by_y]| splat(by_x).mul_add(x, y * splat(by_y)))
        } else {
            let y = pixels.rows(self.simd, place) + splat(pixels.top);
            let [dx, dy] = [x - self.base[0], y - self.base[1]];
            [dx * self.inverse_u, (-self.shear).mul_add(dx, dy) * self.inverse_v]
        }
    }
}

impl<S: Simd, F: Real> FootprintLanes<S, F> for RayLanes<S, F> {
    /// Centres along x, px.
    type Column = F::Block<S>;
    type Point = RayPoint<S, F>;

    #[inline(always)]
    fn opacity(&self) -> F::Block<S> {
        self.opacity
    }

    #[inline(always)]
    fn column(&self, x: F::Block<S>) -> F::Block<S> {
        x
    }

    #[inline(always)]
    fn at(&self, x: &F::Block<S>, pixels: &TilePixels<F>, place: usize) -> SplatAt<S, F, RayPoint<S, F>> {
        let constant = |value: F| F::Block::<S>::splat(self.simd, value);
        let (zero, one) = (constant(F::ZERO), constant(F::ONE));
        let half_log2_e = constant(F::of(WHITEN * WHITEN));
        let [u, v] = self.whitened(*x, pixels, place);
        let square = u.mul_add(u, v * v);
        let [slope_u, slope_v] = self.depth_slope;
        let s = (-slope_u).mul_add(u, (-slope_v).mul_add(v, one));
        let d = self.thick.mul_add(square, s * s);
        let (lambda, along, apart, exponent, inverse, sound);
        if self.splat.beyond {
            let ([alpha, beta], gamma, thick) = (self.centre, self.gamma, self.thick);
            let dot = alpha.mul_add(u, beta * v);
            let product = gamma.mul_add(s, thick * dot);
            sound = d.simd_gt(constant(F::of(D_MIN))) & product.simd_gt(zero);
            inverse = sound.select(one / d, zero);
            (lambda, along) = (product * inverse, s * inverse);
            let [a, b] = [lambda.mul_add(u, -alpha), lambda.mul_add(v, -beta)];
            let c = inverse * gamma.mul_add(square, -s * dot);
            apart = [a, b, c];
            exponent = a.mul_add(a, b.mul_add(b, thick * c * c)) * half_log2_e;
        } else {
            sound = s.simd_gt(constant(F::of(D_MIN.sqrt())));
            inverse = sound.select(one / d, zero);
            lambda = s * inverse;
            along = lambda;
            apart = [lambda * u, lambda * v, square * inverse];
            exponent = apart[2] * half_log2_e;
        }
        let depth = lambda * self.depth;
        let near = exponent.simd_le(self.extent) & sound & depth.abs().simd_le(constant(F::MAX));
        let depth_factor = near.select(lambda, zero);
        SplatAt { exponent, near, depth_factor, point: RayPoint { u, v, inverse, along, apart } }
    }

    /// The module's documentation has the formulas.
    #[inline(always)]
    fn add(
        &self,
        sums: &mut PairSums<S, F>,
        point: &RayPoint<S, F>,
        h: F::Block<S>,
        of_depth: Option<F::Block<S>>,
        absolute: bool,
    ) {
        let RayPoint { u, v, inverse, along, apart: [a, b, c] } = *point;
        let [slope_u, slope_v] = self.depth_slope;
        // `r` of the module's documentation.
        let reach = [c.mul_add(slope_u, a), c.mul_add(slope_v, b)];
        let through = h * c;
        let (mut of_gamma, mut of_thickness) = (-through, c * through);
        // The negative gradients of `α` and `β`.
        let mut of_centre = each!(reach, |reach| h * reach);
        let (moments, slopes) = (&mut sums.moments, &mut sums.slopes);
        if let Some(of_depth) = of_depth {
            let of_lambda = of_depth * self.depth;
            let (far, along_s) = (of_lambda * self.thick * inverse, of_lambda * along);
            of_gamma += along_s;
            of_thickness -= c * (along_s + along_s);
            of_centre[0] += far.mul_add(u, -(along_s * slope_u));
            of_centre[1] += far.mul_add(v, -(along_s * slope_v));
            let (of_ray, of_s) = (each!(reach, |reach| far * reach), far * c);
            moments[3] = of_ray[0].mul_add(u, moments[3]);
            moments[4] = of_ray[1].mul_add(u, moments[4]);
            moments[5] = of_ray[1].mul_add(v, moments[5]);
            slopes[0] -= of_s * u;
            slopes[1] -= of_s * v;
        }
        slopes[0] = of_gamma.mul_add(a, slopes[0]);
        slopes[1] = of_gamma.mul_add(b, slopes[1]);
        slopes[2] = of_thickness.mul_add(F::Block::<S>::splat(self.simd, self.splat.thick.sqrt()), slopes[2]);
        slopes[3] += of_gamma;
        moments[0] += h;
        moments[1] += of_centre[0];
        moments[2] += of_centre[1];
        moments[3] = of_centre[0].mul_add(a, moments[3]);
        moments[4] = of_centre[1].mul_add(a, moments[4]);
        moments[5] = of_centre[1].mul_add(b, moments[5]);
        if absolute {
            let per_v = of_centre[1] * self.inverse_v;
            sums.absolute[0] += (of_centre[0] * self.inverse_u - per_v * self.shear).abs();
            sums.absolute[1] += per_v.abs();
        }
    }
}
