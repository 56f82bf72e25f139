//! A Gaussian in the CPU twin, and its evaluation at a vector of pixels.

use fearless_simd::prelude::*;

use super::{D_MIN, RayLayers, WHITENED_MAX};
use crate::intersect::extent::widened_limit;
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::RasterizeSpec;
use crate::rasterize::footprint::WHITEN;
use crate::ray_space::{LensFrame, LensLimits, beyond, columns};
use crate::simd::each;
use crate::simd::real::{EXP2_CONSTANTS, Real};

/// A Gaussian in the form that the loops over pixels multiply by. Nothing is scaled, as it is in `rasterize`: where `s` is a small
/// difference of products, their rounding would show.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct RayFootprint<F> {
    /// Origin of the whitened coordinates: the centre, or the point of the picture's border nearest to it, px.
    pub base_px: [F; 2],
    pub inverse_u: F,
    pub inverse_v: F,
    pub shear: F,
    pub opacity: F,
    /// Largest exponent: beyond it the alpha is certainly below `alpha_min`. A negative extent never shows.
    extent: F,
    pub depth_slope: [F; 2],
    /// The square of the thickness.
    pub thick: F,
    pub depth: F,
    /// `(α, β)` and `γ`: the centre relative to the origin.
    pub centre: [F; 2],
    pub gamma: F,
    /// Whether the centre is not the origin.
    pub beyond: bool,
}

impl<F: Real> RayFootprint<F> {
    /// Reads the Gaussian `i`.
    pub fn new(inputs: &RayLayers<&[F]>, i: usize, (spec, lens): (&RasterizeSpec, Option<&LensLimits<F>>)) -> Self {
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
            lens.map_or(far, |lens| far.max_of(frame.farthest(lens, axis)))
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
        }
    }

    /// Returns the columns of a lens that take the slopes of a ray to its whitened coordinates, from those that take them to px.
    #[inline(always)]
    pub fn whitening(&self, frame: LensFrame<F>) -> LensFrame<F> {
        let [x, y] = frame.by;
        let u = each!(x, |by| by * self.inverse_u);
        let v = each!([0, 1], |slope| (y[slope] - self.shear * x[slope]) * self.inverse_v);
        LensFrame { by: [u, v], ..frame }
    }

    /// Returns the whitened coordinates `u` and `v` of pixels.
    #[inline(always)]
    fn whiten<S: Simd>(&self, pixels: &RayPixels<S, F>) -> [F::Block<S>; 2] {
        let lanes = |value: F| F::Block::<S>::splat(pixels.x.token(), value);
        let [dx, dy] = [pixels.x - lanes(self.base_px[0]), pixels.y - lanes(self.base_px[1])];
        [dx * lanes(self.inverse_u), lanes(-self.shear).mul_add(dx, dy) * lanes(self.inverse_v)]
    }
}

/// Render options that affect pixels, one copy in each lane.
pub(super) struct RayRules<S: Simd, F: Real> {
    simd: S,
    pub zero: F::Block<S>,
    one: F::Block<S>,
    half_log2_e: F::Block<S>,
    /// At least the smallest positive number: an alpha of zero contributes nothing.
    alpha_min: F::Block<S>,
    /// Limits of `s`, `D` and the depth.
    nearest: F::Block<S>,
    d_min: F::Block<S>,
    farthest: F::Block<S>,
    pub alpha_max: F::Block<S>,
    /// A value below zero disables the threshold.
    pub transmittance_min: F::Block<S>,
    exp2: [F::Block<S>; EXP2_CONSTANTS],
}

/// Centres of a vector of pixels, px, and the slopes of their rays if the camera has a lens.
#[derive(Clone, Copy)]
pub(super) struct RayPixels<S: Simd, F: Real> {
    pub x: F::Block<S>,
    pub y: F::Block<S>,
    pub slopes: Option<[F::Block<S>; 2]>,
}

/// A Gaussian at a vector of pixels.
pub(super) struct RayLayerSimd<S: Simd, F: Real> {
    pub u: F::Block<S>,
    pub v: F::Block<S>,
    /// `1/D`, or zero where `λ` is set to zero.
    pub inverse: F::Block<S>,
    /// `s/D`; `a`, `b` and `c`.
    pub along: F::Block<S>,
    pub apart: [F::Block<S>; 3],
    /// `λ z`, scene units.
    pub depth: F::Block<S>,
    /// Zero where the Gaussian does not show.
    pub alpha: F::Block<S>,
    pub shows: <F::Block<S> as SimdBase<S>>::Mask,
}

impl<S: Simd, F: Real> RayRules<S, F> {
    #[inline(always)]
    pub fn new(simd: S, spec: &RasterizeSpec) -> Self {
        let options = &spec.options;
        let lanes = |value| F::Block::<S>::splat(simd, F::of(value));
        let mut exp2 = [lanes(0.0); EXP2_CONSTANTS];
        for (constant, value) in exp2.iter_mut().zip(F::EXP2) {
            *constant = F::Block::<S>::splat(simd, value);
        }
        Self {
            simd,
            zero: lanes(0.0),
            one: lanes(1.0),
            half_log2_e: lanes(WHITEN * WHITEN),
            alpha_min: F::Block::<S>::splat(simd, F::of(options.alpha_min).max_of(F::MIN_POSITIVE)),
            nearest: lanes(D_MIN.sqrt()),
            d_min: lanes(D_MIN),
            farthest: F::Block::<S>::splat(simd, F::MAX),
            alpha_max: lanes(options.alpha_max),
            // A threshold of zero omits nothing, not even layers behind an alpha of one.
            transmittance_min: lanes(if options.transmittance_min > 0.0 { options.transmittance_min } else { -1.0 }),
            exp2: std::hint::black_box(exp2),
        }
    }

    /// Evaluates a Gaussian, whose frame is [`RayFootprint::whitening`] if there is a lens. `known` is `inverse`, if it is known from
    /// before.
    #[inline(always)]
    pub fn layer(
        &self,
        (splat, frame): (&RayFootprint<F>, Option<&LensFrame<F>>),
        pixels: &RayPixels<S, F>,
        known: Option<F::Block<S>>,
    ) -> RayLayerSimd<S, F> {
        let simd = self.simd;
        let lanes = |value: F| F::Block::<S>::splat(simd, value);
        // Of the pixel's ray where there is a lens, and of its position.
        let [u, v] = match (pixels.slopes, frame) {
            (Some([x, y]), Some(frame)) => {
                let (x, y) = (x - lanes(frame.centre[0]), y - lanes(frame.centre[1]));
                each!(frame.by, |[by_x, by_y]| lanes(by_x).mul_add(x, y * lanes(by_y)))
            }
            _ => splat.whiten(pixels),
        };
        let square = u.mul_add(u, v * v);
        let [slope_u, slope_v] = each!(splat.depth_slope, |slope| lanes(-slope));
        let s = slope_u.mul_add(u, slope_v.mul_add(v, self.one));
        let d = lanes(splat.thick).mul_add(square, s * s);
        let (lambda, along, apart, exponent, inverse, sound);
        if splat.beyond {
            let ([alpha, beta], gamma, thick) =
                (each!(splat.centre, |value| lanes(value)), lanes(splat.gamma), lanes(splat.thick));
            let dot = alpha.mul_add(u, beta * v);
            let product = gamma.mul_add(s, thick * dot);
            sound = d.simd_gt(self.d_min) & product.simd_gt(self.zero);
            inverse = match known {
                Some(inverse) => inverse,
                None => sound.select(self.one / d, self.zero),
            };
            (lambda, along) = (product * inverse, s * inverse);
            let [a, b] = [lambda.mul_add(u, -alpha), lambda.mul_add(v, -beta)];
            let c = inverse * gamma.mul_add(square, -s * dot);
            apart = [a, b, c];
            exponent = a.mul_add(a, b.mul_add(b, thick * c * c)) * self.half_log2_e;
        } else {
            sound = s.simd_gt(self.nearest);
            inverse = match known {
                Some(inverse) => inverse,
                None => sound.select(self.one / d, self.zero),
            };
            lambda = s * inverse;
            along = lambda;
            apart = [lambda * u, lambda * v, square * inverse];
            exponent = apart[2] * self.half_log2_e;
        }
        let depth = lambda * lanes(splat.depth);
        let near = exponent.simd_le(lanes(splat.extent)) & sound & depth.abs().simd_le(self.farthest);
        let power = F::exp2_lanes::<S, F::Block<S>>(exponent, &self.exp2);
        let value = (lanes(splat.opacity) * power).min(self.alpha_max);
        let shows = near & value.simd_ge(self.alpha_min);
        let alpha = shows.select(value, self.zero);
        RayLayerSimd { u, v, inverse, along, apart, depth, alpha, shows }
    }
}
