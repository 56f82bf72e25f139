//! One pixel in the CPU twin: the evaluation of a Gaussian, the layers front to back, and their gradients.

use super::{D_MIN, WHITENED_MAX};
use crate::depth_slope::DEPTH_SLOPE;
use crate::intersect::extent::widened_limit;
use crate::options::{Order, Projection};
use crate::project::Ellipse;
use crate::simd::real::Real;

/// A Gaussian as pixels evaluate it.
#[derive(Clone, Copy, Default)]
pub(super) struct RayGaussianCpu<F> {
    pub ellipse: Ellipse<F>,
    /// With the affine projection, used for the order only.
    pub depth_slope: [F; DEPTH_SLOPE],
    inverse_u: F,
    inverse_v: F,
    /// Exponent above which alpha is certainly below `alpha_min`.
    limit: F,
}

impl<F: Real> RayGaussianCpu<F> {
    /// Reads a packed ellipse and its depth slope.
    pub fn new(row: &[F], depth_slope: &[F], rules: &Rules<F>) -> Self {
        let ellipse = Ellipse::from_row(row);
        Self {
            ellipse,
            depth_slope: [depth_slope[0], depth_slope[1], depth_slope[2]],
            inverse_u: F::ONE / ellipse.sigma_u,
            inverse_v: F::ONE / ellipse.sigma_v,
            limit: F::of(0.5) * widened_limit(ellipse.opacity, rules.alpha_min),
        }
    }
}

/// Render options that affect pixels.
#[derive(Clone, Copy)]
pub(super) struct Rules<F> {
    pub exact: bool,
    pub per_pixel: bool,
    pub alpha_min: F,
    pub alpha_max: F,
    /// A value below zero disables the threshold.
    pub transmittance_min: F,
}

impl<F: Real> Rules<F> {
    pub fn new(options: &crate::RenderOptions) -> Self {
        // A threshold of zero omits nothing, not even layers behind an alpha of one.
        let least = if options.transmittance_min > 0.0 { options.transmittance_min } else { -1.0 };
        Self {
            exact: options.projection == Projection::RayMax,
            per_pixel: options.order == Order::PerPixelSort,
            alpha_min: F::of(options.alpha_min),
            alpha_max: F::of(options.alpha_max),
            transmittance_min: F::of(least),
        }
    }
}

/// A Gaussian evaluated at a pixel, with the names of the module's documentation.
#[derive(Clone, Copy)]
pub(super) struct RayLayerCpu<F> {
    /// Place in the tile's list.
    pub place: usize,
    pub gaussian: u32,
    u: F,
    v: F,
    exponent: F,
    lambda: F,
    phi: F,
    /// Sort key `λ z`.
    pub key: F,
    pub alpha: F,
    /// Whether alpha is below its limit.
    free: bool,
    /// Transmittance before the layer.
    pub before: F,
}

impl<F: Real> RayLayerCpu<F> {
    /// Evaluates a Gaussian at the pixel with its centre at `at`, px. Returns `None` if the Gaussian does not contribute.
    #[inline(always)]
    fn new(
        footprint: &RayGaussianCpu<F>,
        at: [F; 2],
        rules: &Rules<F>,
        (place, gaussian): (usize, u32),
    ) -> Option<Self> {
        let (e, [depth_slope_u, depth_slope_v, thickness]) = (&footprint.ellipse, footprint.depth_slope);
        let (widest, farthest) = (F::of(WHITENED_MAX), F::of(WHITENED_MAX * WHITENED_MAX));
        let (dx, dy) = (at[0] - e.mean_px[0], at[1] - e.mean_px[1]);
        let u = (dx * footprint.inverse_u).within(-widest, widest);
        let v = ((dy - e.shear * dx) * footprint.inverse_v).within(-widest, widest);
        let square = u * u + v * v;
        let s = (F::ONE - (depth_slope_u * u + depth_slope_v * v)).within(-farthest, farthest);
        let thick = thickness * thickness;
        let d = s * s + thick * square;
        let half = F::of(0.5) * square;
        // Most Gaussians of a tile do not contribute to a given pixel; this test rejects them without a division.
        if half > footprint.limit * if rules.exact { d } else { F::ONE } {
            return None;
        }
        let sound = d > F::of(D_MIN);
        let (lambda, phi) = if sound { (s / d, thick / d) } else { (F::ZERO, F::ZERO) };
        let exponent = match rules.exact {
            true if s > F::ZERO && sound => half / d,
            true => return None,
            false => half,
        };
        let whole = e.opacity * (-exponent).exp();
        let alpha = whole.min_of(rules.alpha_max);
        // The comparison is false for a NaN, and an alpha of zero contributes nothing.
        let shows = alpha >= rules.alpha_min && alpha > F::ZERO;
        shows.then(|| Self {
            place,
            gaussian,
            u,
            v,
            exponent,
            lambda,
            phi,
            key: lambda * e.depth,
            alpha,
            free: whole < rules.alpha_max,
            before: F::ZERO,
        })
    }

    /// Depth of the layer, scene units.
    #[inline(always)]
    pub fn depth(&self, footprint: &RayGaussianCpu<F>, rules: &Rules<F>) -> F {
        if rules.exact { self.key } else { footprint.ellipse.depth }
    }
}

/// Fills `layers` with the contributions to a pixel, front to back, and returns the transmittance behind them.
#[inline(always)]
pub(super) fn look<F: Real>(
    footprints: &[RayGaussianCpu<F>],
    gaussians: &[u32],
    at: [F; 2],
    rules: &Rules<F>,
    layers: &mut Vec<RayLayerCpu<F>>,
) -> F {
    layers.clear();
    let mut transmittance = F::ONE;
    // Applies a layer to the transmittance, unless the layer ends the pixel.
    let pass = |transmittance: &mut F, layer: &mut RayLayerCpu<F>| {
        let behind = *transmittance - layer.alpha * *transmittance;
        layer.before = *transmittance;
        let ends = behind <= rules.transmittance_min;
        if !ends {
            *transmittance = behind;
        }
        !ends
    };
    for (place, &gaussian) in gaussians.iter().enumerate() {
        let Some(mut layer) = RayLayerCpu::new(&footprints[gaussian as usize], at, rules, (place, gaussian)) else {
            continue;
        };
        if !rules.per_pixel && !pass(&mut transmittance, &mut layer) {
            break;
        }
        layers.push(layer);
    }
    if rules.per_pixel {
        layers.sort_unstable_by(|a, b| {
            let by_key = a.key.partial_cmp(&b.key).unwrap_or(std::cmp::Ordering::Equal);
            by_key.then(a.gaussian.cmp(&b.gaussian))
        });
        let ends = layers.iter_mut().position(|layer| !pass(&mut transmittance, layer));
        let seen = ends.unwrap_or(layers.len());
        layers.truncate(seen);
    }
    transmittance
}

/// Gradient of one layer from one pixel.
pub(super) struct LayerGrad<F> {
    /// `h = α ∂L/∂α` where alpha is below its limit, the negative gradients `p, q` of `u` and `v`, and `p u, q u, q v`: the
    /// moments of `rasterize`.
    pub moments: [F; 6],
    /// `α T`, the factor from the gradient of a channel to the gradient of its feature.
    pub weight: F,
    /// Gradient of the depth.
    pub depth: F,
    /// Gradients of the depth slopes and the thickness, then the absolute gradient of the projected centre, per px.
    pub rest: [F; DEPTH_SLOPE + 2],
}

impl<F: Real> RayLayerCpu<F> {
    /// Computes the gradient from `∂L/∂α` and the gradient of the depth plane.
    #[inline(always)]
    pub fn backward(
        &self,
        footprint: &RayGaussianCpu<F>,
        rules: &Rules<F>,
        grad_alpha: F,
        grad_depth: F,
    ) -> LayerGrad<F> {
        let (e, [depth_slope_u, depth_slope_v, thickness]) = (&footprint.ellipse, footprint.depth_slope);
        let Self { u, v, exponent, lambda, phi, .. } = *self;
        let (two, four) = (F::of(2.0), F::of(4.0));
        let weight = self.alpha * self.before;
        let h = if self.free { self.alpha * grad_alpha } else { F::ZERO };
        let seen = weight * grad_depth;
        let (mut p, mut q, mut depth, mut of_slope) = (h * u, h * v, seen, [F::ZERO; DEPTH_SLOPE]);
        if rules.exact {
            let of_lambda = seen * e.depth;
            let kappa = two * exponent * phi - lambda * lambda;
            // Negative gradients of E and λ along (u, v), and along the depth slope.
            let radial = h * lambda * lambda + of_lambda * two * lambda * phi;
            let across = h * two * exponent * lambda + of_lambda * kappa;
            (p, q) = (radial * u + across * depth_slope_u, radial * v + across * depth_slope_v);
            let of_thickness = four * exponent * thickness * (h * exponent - of_lambda * lambda);
            (depth, of_slope) = (seen * lambda, [-(across * u), -(across * v), of_thickness]);
        }
        let per_v = q / e.sigma_v;
        let [of_u, of_v, of_thickness] = of_slope;
        let rest = [of_u, of_v, of_thickness, (e.shear * per_v - p / e.sigma_u).abs(), per_v.abs()];
        LayerGrad { moments: [h, p, q, p * u, q * u, q * v], weight, depth, rest }
    }
}
