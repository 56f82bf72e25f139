//! CPU twin, parallel over runs of Gaussians of one length, whose sums are added in their order.

use rayon::prelude::*;

use super::{AperturePart, Exposed, Exposure, LARGEST_SHARE, OpticsSpec, PARAMETERS};
use crate::linalg::norm;
use crate::project::COLUMNS;
use crate::simd::real::Real;

/// Number of Gaussians per task.
const RUN: usize = 1024;

/// A packed ellipse, or its gradient.
#[derive(Clone, Copy)]
pub(super) struct Ellipse<F> {
    x: F,
    y: F,
    sigma_u: F,
    shear: F,
    sigma_v: F,
    depth: F,
    opacity: F,
}

impl<F: Real> Ellipse<F> {
    pub fn load(&[x, y, sigma_u, shear, sigma_v, depth, opacity]: &[F; COLUMNS]) -> Self {
        Self { x, y, sigma_u, shear, sigma_v, depth, opacity }
    }

    pub fn store(self, to: &mut [F; COLUMNS]) {
        *to = [self.x, self.y, self.sigma_u, self.shear, self.sigma_v, self.depth, self.opacity];
    }
}

/// The length of a vector in the plane.
fn hypotenuse<F: Real>(a: F, b: F) -> F {
    norm([a, b, F::ZERO])
}

/// A widening by `w wᵀ + diag(0, round²)`, and its parts that the derivative needs.
pub(super) struct Widened<F> {
    w: [F; 2],
    round: F,
    sigma_u: F,
    sigma_v: F,
    /// `sigma_u`, `w_x` and `w_y` over the new `sigma_u`.
    share: F,
    across: F,
    along: F,
    /// `w_y − shear w_x`.
    off: F,
}

/// Gradients of a widening.
pub(super) struct WidenedGrad<F> {
    pub ellipse: Ellipse<F>,
    pub w: [F; 2],
    pub round: F,
}

impl<F: Real> Widened<F> {
    pub fn new(e: &Ellipse<F>, w: [F; 2], round: F) -> Self {
        let sigma_u = hypotenuse(e.sigma_u, w[0]);
        let [share, across, along] = [e.sigma_u, w[0], w[1]].map(|part| part / sigma_u);
        let off = w[1] - e.shear * w[0];
        Self { w, round, sigma_u, sigma_v: norm([e.sigma_v, share * off, round]), share, across, along, off }
    }

    pub fn of(&self, e: Ellipse<F>) -> Ellipse<F> {
        let &Self { sigma_u, sigma_v, share, across, along, .. } = self;
        let shear = share * share * e.shear + across * along;
        Ellipse { sigma_u, shear, sigma_v, opacity: e.opacity * share * (e.sigma_v / sigma_v), ..e }
    }

    pub fn backward(&self, e: &Ellipse<F>, grad: &Ellipse<F>) -> WidenedGrad<F> {
        let &Self { share, across, along, off, .. } = self;
        let [of_u, of_v] = [F::ONE / self.sigma_u, F::ONE / self.sigma_v];
        // The parts of the new `sigma_v`, whose squares add up to one.
        let [kept, slanted, round] = [e.sigma_v, share * off, self.round].map(|part| part * of_v);
        let grad_kept = grad.opacity * e.opacity * share;
        let grad_v = grad.sigma_v - grad_kept * kept * of_v;
        let sigma_v = grad.sigma_v * kept + grad_kept * (slanted * slanted + round * round) * of_v;
        let grad_slanted = grad_v * slanted;
        let grad_off = grad_slanted * share;
        let grad_share =
            grad.opacity * e.opacity * kept + grad_slanted * off + (grad.shear + grad.shear) * share * e.shear;
        let (grad_across, grad_along) = (grad.shear * along, grad.shear * across);
        // `share` and `across` are the sides of a triangle of length one: what changes both alike changes neither.
        let turned = (grad_across * share - grad_share * across) * of_u;
        let radial = grad.sigma_u - grad_along * along * of_u;
        let ellipse = Ellipse {
            sigma_u: radial * share - turned * across,
            shear: grad.shear * share * share - grad_off * self.w[0],
            sigma_v,
            opacity: grad.opacity * share * kept,
            ..*grad
        };
        let w = [radial * across + turned * share - grad_off * e.shear, grad_off + grad_along * of_u];
        WidenedGrad { ellipse, w, round: grad_v * round }
    }
}

/// The motion of a centre, and its parts that the derivative needs.
pub(super) struct Moving<F> {
    /// px.
    pub velocity: [F; 2],
    slope: [F; 2],
    /// Whether the centre is not clamped.
    free: [bool; 2],
    inverse_depth: F,
    /// `τ − s τ_z`.
    pull: [F; 2],
}

impl<F: Real> Moving<F> {
    pub fn new(e: &Ellipse<F>, twist: &[F; PARAMETERS], axes: &[[F; 4]; 2]) -> Self {
        let &[wx, wy, wz, tx, ty, tz] = twist;
        let inverse_depth = F::ONE / e.depth;
        let (mut slope, mut free) = ([F::ZERO; 2], [false; 2]);
        for (axis, px) in [e.x, e.y].into_iter().enumerate() {
            let [focal, principal, low, high] = axes[axis];
            slope[axis] = (px.within(low, high) - principal) / focal;
            free[axis] = px >= low && px <= high;
        }
        let [x, y] = slope;
        let pull = [tx - x * tz, ty - y * tz];
        let across = pull[0] * inverse_depth + wy * (F::ONE + x * x) - wx * x * y - wz * y;
        let down = pull[1] * inverse_depth - wx * (F::ONE + y * y) + wy * x * y + wz * x;
        Self { velocity: [axes[0][0] * across, axes[1][0] * down], slope, free, inverse_depth, pull }
    }

    /// Adds the gradients of the ellipse, and returns those of the twist.
    fn backward(
        &self,
        twist: &[F; PARAMETERS],
        axes: &[[F; 4]; 2],
        grad: [F; 2],
        of: &mut Ellipse<F>,
    ) -> [F; PARAMETERS] {
        let &[wx, wy, wz, _, _, tz] = twist;
        let &Self { slope: [x, y], inverse_depth, .. } = self;
        let (across, down) = (grad[0] * axes[0][0], grad[1] * axes[1][0]);
        let twice = |value: F| value + value;
        let of_x = across * (twice(wy * x) - wx * y - tz * inverse_depth) + down * (wy * y + wz);
        let of_y = down * (wy * x - twice(wx * y) - tz * inverse_depth) - across * (wx * x + wz);
        of.x += if self.free[0] { of_x / axes[0][0] } else { F::ZERO };
        of.y += if self.free[1] { of_y / axes[1][0] } else { F::ZERO };
        of.depth -= (across * self.pull[0] + down * self.pull[1]) * inverse_depth * inverse_depth;
        [
            -(across * x * y) - down * (F::ONE + y * y),
            across * (F::ONE + x * x) + down * x * y,
            down * x - across * y,
            across * inverse_depth,
            down * inverse_depth,
            -(across * x + down * y) * inverse_depth,
        ]
    }
}

/// A map of an ellipse by a rolling shutter, and its parts that the derivative needs.
pub(super) struct Rolled<F> {
    /// Velocity over the picture's height.
    shares: [F; 2],
    /// Whether the vertical velocity is not clamped.
    free: bool,
    k: F,
    q: F,
    /// `y − H/2`, and times `k`.
    below: F,
    lag: F,
    sigma_u: F,
    /// Row 0 of `M L`, `sigma_u` and `sigma_v` over the new `sigma_u`.
    along: F,
    across: F,
    share: F,
    ratio: F,
    /// The new shear over `k`.
    turned: F,
}

impl<F: Real> Rolled<F> {
    pub fn new(e: &Ellipse<F>, velocity: [F; 2], height: F) -> Self {
        let largest = F::of(LARGEST_SHARE);
        let vertical = velocity[1] / height;
        let shares = [velocity[0] / height, vertical.within(-largest, largest)];
        let k = F::ONE / (F::ONE - shares[1]);
        let q = k * shares[0];
        let below = e.y - F::of(0.5) * height;
        let row = [e.sigma_u * (F::ONE + q * e.shear), q * e.sigma_v];
        let sigma_u = hypotenuse(row[0], row[1]);
        let [along, across, share, ratio] = [row[0], row[1], e.sigma_u, e.sigma_v].map(|part| part / sigma_u);
        let turned = along * (e.shear * share) + across * ratio;
        let free = vertical.abs() <= largest;
        Self { shares, free, k, q, below, lag: below * k, sigma_u, along, across, share, ratio, turned }
    }

    pub fn of(&self, e: Ellipse<F>) -> Ellipse<F> {
        let &Self { shares, k, lag, sigma_u, share, turned, .. } = self;
        let (x, y) = (e.x + shares[0] * lag, e.y + shares[1] * lag);
        Ellipse { x, y, sigma_u, shear: k * turned, sigma_v: k * e.sigma_v * share, ..e }
    }

    /// Returns the gradients of the ellipse and of the velocity.
    fn backward(&self, e: &Ellipse<F>, grad: &Ellipse<F>, height: F) -> (Ellipse<F>, [F; 2]) {
        let &Self { shares, k, q, sigma_u, along, across, share, ratio, turned, .. } = self;
        let (grad_turned, grad_narrow) = (grad.shear * k, grad.sigma_v * k);
        // Derivatives of `turned` with differences taken by hand: with `c = 1 + q shear`, `c − q shear = 1`.
        let twisted = (grad_turned + grad_turned) * along * across / sigma_u;
        let grad_q = grad.sigma_u * turned * sigma_u + grad_turned * (share * share * ratio * ratio - turned * turned)
            - grad_narrow * e.sigma_v * share * turned;
        let grad_lag = grad.x * shares[0] + grad.y * shares[1];
        let grad_k = grad.shear * turned + grad.sigma_v * e.sigma_v * share + grad_q * shares[0];
        let grad_k = grad_k + grad_lag * self.below;
        let grad_down = grad.y * self.lag + grad_k * k * k;
        let ellipse = Ellipse {
            y: grad.y + grad_lag * k,
            sigma_u: grad.sigma_u * along * (F::ONE + q * e.shear) - twisted * ratio
                + grad_narrow * ratio * across * across,
            shear: grad.sigma_u * along * e.sigma_u * q
                + grad_turned * share * share * (along * along - across * across)
                - grad_narrow * e.sigma_v * share * share * along * q,
            sigma_v: grad.sigma_u * across * q + twisted * share + grad_narrow * share * along * along,
            ..*grad
        };
        let down = if self.free { grad_down / height } else { F::ZERO };
        (ellipse, [(grad.x * self.lag + grad_q * k) / height, down])
    }
}

/// Constants and parameters of a change, in the float type of the twin.
struct Change<F> {
    exposure: Exposure,
    axes: [[F; 4]; 2],
    height: F,
    parameters: [F; PARAMETERS],
    /// Radius of the aperture, scene units, of defocus.
    aperture: F,
}

impl<F: Real> Change<F> {
    fn new(parameters: &[F], spec: &OpticsSpec) -> Self {
        let mut all = [F::ZERO; PARAMETERS];
        all[..parameters.len()].copy_from_slice(parameters);
        let axes = spec.axes().map(|axis| axis.map(F::of));
        let (height, aperture) = (F::of(spec.intrinsics.height as f64), F::of(all[0].f64().exp()));
        Self { exposure: spec.exposure, axes, height, parameters: all, aperture }
    }

    /// The deviation of a motion blur with this velocity.
    fn blur(velocity: [F; 2]) -> [F; 2] {
        velocity.map(|v| v * F::of(1.0 / 12_f64.sqrt()))
    }

    /// Radius of the circle of confusion in units of the focal length.
    fn confusion(&self, e: &Ellipse<F>) -> F {
        (F::ONE / e.depth - self.parameters[1]) * self.aperture
    }

    /// Radii of the circle of confusion along x and y, px, and the widening by the part's.
    fn defocus(&self, e: &Ellipse<F>, confusion: F, part: AperturePart) -> ([F; 2], Widened<F>) {
        let radii = [self.axes[0][0] * confusion, self.axes[1][0] * confusion];
        let deviation = F::of(part.deviation);
        (radii, Widened::new(e, [radii[0] * deviation, F::ZERO], radii[1] * deviation))
    }

    fn of(&self, e: Ellipse<F>) -> Ellipse<F> {
        if e.depth == F::ZERO {
            return e;
        }
        let velocity = || Moving::new(&e, &self.parameters, &self.axes).velocity;
        match self.exposure {
            Exposure::MotionBlur => Widened::new(&e, Self::blur(velocity()), F::ZERO).of(e),
            Exposure::RollingShutter => Rolled::new(&e, velocity(), self.height).of(e),
            Exposure::Defocus(part) => {
                let (radii, widened) = self.defocus(&e, self.confusion(&e), part);
                let [px, py] = part.place.map(F::of);
                let Ellipse { x, y, .. } = e;
                Ellipse { x: x + radii[0] * px, y: y + radii[1] * py, ..widened.of(e) }
            }
        }
    }

    /// Returns the gradient of the ellipse, and adds that of the parameters.
    fn backward(&self, e: &Ellipse<F>, grad: &Ellipse<F>, sums: &mut [F; PARAMETERS]) -> Ellipse<F> {
        if e.depth == F::ZERO {
            return *grad;
        }
        let Self { parameters, axes, .. } = self;
        let moving = || Moving::new(e, parameters, axes);
        let (ellipse, of_parameters) = match self.exposure {
            Exposure::MotionBlur => {
                let moving = moving();
                let WidenedGrad { mut ellipse, w, .. } =
                    Widened::new(e, Self::blur(moving.velocity), F::ZERO).backward(e, grad);
                let twist = moving.backward(parameters, axes, Self::blur(w), &mut ellipse);
                (ellipse, twist)
            }
            Exposure::RollingShutter => {
                let moving = moving();
                let (mut ellipse, velocity) =
                    Rolled::new(e, moving.velocity, self.height).backward(e, grad, self.height);
                let twist = moving.backward(parameters, axes, velocity, &mut ellipse);
                (ellipse, twist)
            }
            Exposure::Defocus(part) => {
                let (confusion, aperture) = (self.confusion(e), self.aperture);
                let WidenedGrad { mut ellipse, w, round } = self.defocus(e, confusion, part).1.backward(e, grad);
                let ([px, py], deviation) = (part.place.map(F::of), F::of(part.deviation));
                let of_radii = [w[0] * deviation + grad.x * px, round * deviation + grad.y * py];
                let of_confusion = of_radii[0] * axes[0][0] + of_radii[1] * axes[1][0];
                ellipse.depth -= of_confusion * aperture / (e.depth * e.depth);
                let zero = F::ZERO;
                (ellipse, [of_confusion * confusion, -(of_confusion * aperture), zero, zero, zero, zero])
            }
        };
        sums.iter_mut().zip(of_parameters).for_each(|(sum, value)| *sum += value);
        ellipse
    }
}

/// Returns the changed ellipses, `[N, 7]`.
pub(crate) fn expose_cpu<F: Real>(inputs: Exposed<&[F]>, spec: &OpticsSpec) -> Vec<F> {
    let change = Change::new(inputs.parameters, spec);
    let mut out = vec![F::ZERO; inputs.projected.len()];
    let runs = out.par_chunks_mut(RUN * COLUMNS).zip(inputs.projected.par_chunks(RUN * COLUMNS));
    runs.for_each(|(out, rows)| {
        for (out, row) in out.as_chunks_mut::<COLUMNS>().0.iter_mut().zip(rows.as_chunks::<COLUMNS>().0) {
            change.of(Ellipse::load(row)).store(out);
        }
    });
    out
}

/// Returns the gradients of the ellipses and of the parameters from `grad`, `[N, 7]`.
pub(crate) fn expose_backward_cpu<F: Real>(inputs: Exposed<&[F]>, grad: &[F], spec: &OpticsSpec) -> Exposed<Vec<F>> {
    let change = Change::new(inputs.parameters, spec);
    let mut projected = vec![F::ZERO; inputs.projected.len()];
    let rows = inputs.projected.par_chunks(RUN * COLUMNS).zip(grad.par_chunks(RUN * COLUMNS));
    let of_run = |(out, (rows, grad)): (&mut [F], (&[F], &[F]))| {
        let mut sums = [F::ZERO; PARAMETERS];
        let rows = rows.as_chunks::<COLUMNS>().0.iter().zip(grad.as_chunks::<COLUMNS>().0);
        for (out, (row, grad)) in out.as_chunks_mut::<COLUMNS>().0.iter_mut().zip(rows) {
            change.backward(&Ellipse::load(row), &Ellipse::load(grad), &mut sums).store(out);
        }
        sums
    };
    let sums: Vec<_> = projected.par_chunks_mut(RUN * COLUMNS).zip(rows).map(of_run).collect();
    let mut parameters = vec![F::ZERO; inputs.parameters.len()];
    for sums in sums {
        parameters.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    Exposed { projected, parameters }
}
