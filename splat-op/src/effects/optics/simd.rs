//! Changes of eight ellipses at a time, one per SIMD lane, and their gradients. Values in the lanes of culled Gaussians are meaningless
//! and are masked before they are returned.

use fearless_simd::prelude::*;

use super::{Exposure, LARGEST_SHARE, OpticsSpec, PARAMETERS};
use crate::project::COLUMNS;
use crate::simd::each;
use crate::simd::lanes::{Lanes, MaskOf, norm};
use crate::simd::real::Real;

/// A packed ellipse, or its gradient.
#[derive(Clone, Copy)]
pub(super) struct EllipseSimd<L> {
    x: L,
    y: L,
    sigma_u: L,
    shear: L,
    sigma_v: L,
    depth: L,
    opacity: L,
}

impl<L: Copy> EllipseSimd<L> {
    #[inline(always)]
    pub fn of_row([x, y, sigma_u, shear, sigma_v, depth, opacity]: [L; COLUMNS]) -> Self {
        Self { x, y, sigma_u, shear, sigma_v, depth, opacity }
    }

    #[inline(always)]
    pub fn to_row(self) -> [L; COLUMNS] {
        [self.x, self.y, self.sigma_u, self.shear, self.sigma_v, self.depth, self.opacity]
    }
}

/// A value of each lane.
#[inline(always)]
fn lanes<S: Simd, F: Real>(simd: S, value: F) -> Lanes<S, F> {
    Lanes::<S, F>::splat(simd, value)
}

/// The length of a vector in the plane.
#[inline(always)]
fn hypotenuse<S: Simd, F: Real>(a: Lanes<S, F>, b: Lanes<S, F>) -> Lanes<S, F> {
    norm::<S, F>(a.token(), [a, b, lanes::<S, F>(a.token(), F::ZERO)])
}

/// A widening by `w wᵀ`, and its parts that the derivative needs.
pub(super) struct WidenedSimd<S: Simd, F: Real> {
    w: [Lanes<S, F>; 2],
    sigma_u: Lanes<S, F>,
    sigma_v: Lanes<S, F>,
    /// `sigma_u`, `w_x` and `w_y` over the new `sigma_u`.
    share: Lanes<S, F>,
    across: Lanes<S, F>,
    along: Lanes<S, F>,
    /// `w_y − shear w_x`.
    off: Lanes<S, F>,
}

/// Gradients of a widening.
pub(super) struct WidenedGrad<L> {
    pub ellipse: EllipseSimd<L>,
    pub w: [L; 2],
}

impl<S: Simd, F: Real> WidenedSimd<S, F> {
    #[inline(always)]
    pub fn new(e: &EllipseSimd<Lanes<S, F>>, w: [Lanes<S, F>; 2]) -> Self {
        let sigma_u = hypotenuse::<S, F>(e.sigma_u, w[0]);
        let [share, across, along] = each!([e.sigma_u, w[0], w[1]], |part| part / sigma_u);
        let off = w[1] - e.shear * w[0];
        Self { w, sigma_u, sigma_v: hypotenuse::<S, F>(e.sigma_v, share * off), share, across, along, off }
    }

    #[inline(always)]
    pub fn of(&self, e: EllipseSimd<Lanes<S, F>>) -> EllipseSimd<Lanes<S, F>> {
        let &Self { sigma_u, sigma_v, share, across, along, .. } = self;
        let shear = share * share * e.shear + across * along;
        EllipseSimd { sigma_u, shear, sigma_v, opacity: e.opacity * share * (e.sigma_v / sigma_v), ..e }
    }

    #[inline(always)]
    pub fn backward(&self, e: &EllipseSimd<Lanes<S, F>>, grad: &EllipseSimd<Lanes<S, F>>) -> WidenedGrad<Lanes<S, F>> {
        let &Self { share, across, along, off, .. } = self;
        let one = lanes::<S, F>(off.token(), F::ONE);
        let [of_u, of_v] = [one / self.sigma_u, one / self.sigma_v];
        // The parts of the new `sigma_v`, whose squares add up to one.
        let [kept, slanted] = each!([e.sigma_v, share * off], |part| part * of_v);
        let grad_kept = grad.opacity * e.opacity * share;
        let grad_v = grad.sigma_v - grad_kept * kept * of_v;
        let sigma_v = grad.sigma_v * kept + grad_kept * slanted * slanted * of_v;
        let grad_slanted = grad_v * slanted;
        let grad_off = grad_slanted * share;
        let grad_share =
            grad.opacity * e.opacity * kept + grad_slanted * off + (grad.shear + grad.shear) * share * e.shear;
        let (grad_across, grad_along) = (grad.shear * along, grad.shear * across);
        // `share` and `across` are the sides of a triangle of length one: what changes both alike changes neither.
        let turned = (grad_across * share - grad_share * across) * of_u;
        let radial = grad.sigma_u - grad_along * along * of_u;
        let ellipse = EllipseSimd {
            sigma_u: radial * share - turned * across,
            shear: grad.shear * share * share - grad_off * self.w[0],
            sigma_v,
            opacity: grad.opacity * share * kept,
            ..*grad
        };
        let w = [radial * across + turned * share - grad_off * e.shear, grad_off + grad_along * of_u];
        WidenedGrad { ellipse, w }
    }
}

/// The motion of a centre, and its parts that the derivative needs.
pub(super) struct MovingSimd<S: Simd, F: Real> {
    /// px.
    pub velocity: [Lanes<S, F>; 2],
    slope: [Lanes<S, F>; 2],
    /// Whether the centre is not clamped.
    free: [MaskOf<S, F>; 2],
    inverse_depth: Lanes<S, F>,
    /// `τ − s τ_z`.
    pull: [Lanes<S, F>; 2],
}

impl<S: Simd, F: Real> MovingSimd<S, F> {
    #[inline(always)]
    pub fn new(e: &EllipseSimd<Lanes<S, F>>, twist: &[Lanes<S, F>; PARAMETERS], axes: &[[Lanes<S, F>; 4]; 2]) -> Self {
        let &[wx, wy, wz, tx, ty, tz] = twist;
        let one = lanes::<S, F>(e.x.token(), F::ONE);
        let inverse_depth = one / e.depth;
        let px = [e.x, e.y];
        let [x, y] = each!([0, 1], |axis| {
            let [focal, principal, low, high] = axes[axis];
            (px[axis].max(low).min(high) - principal) / focal
        });
        let free = each!([0, 1], |axis| px[axis].simd_ge(axes[axis][2]) & px[axis].simd_le(axes[axis][3]));
        let pull = [tx - x * tz, ty - y * tz];
        let across = pull[0] * inverse_depth + wy * (one + x * x) - wx * x * y - wz * y;
        let down = pull[1] * inverse_depth - wx * (one + y * y) + wy * x * y + wz * x;
        Self { velocity: [axes[0][0] * across, axes[1][0] * down], slope: [x, y], free, inverse_depth, pull }
    }

    /// Adds the gradients of the ellipse, and returns those of the twist.
    #[inline(always)]
    fn backward(
        &self,
        twist: &[Lanes<S, F>; PARAMETERS],
        axes: &[[Lanes<S, F>; 4]; 2],
        grad: [Lanes<S, F>; 2],
        of: &mut EllipseSimd<Lanes<S, F>>,
    ) -> [Lanes<S, F>; PARAMETERS] {
        let &[wx, wy, wz, _, _, tz] = twist;
        let &Self { slope: [x, y], inverse_depth, .. } = self;
        let (across, down) = (grad[0] * axes[0][0], grad[1] * axes[1][0]);
        let [zero, one] = [F::ZERO, F::ONE].map(|value| lanes::<S, F>(x.token(), value));
        let of_x = across * (wy * x + wy * x - wx * y - tz * inverse_depth) + down * (wy * y + wz);
        let of_y = down * (wy * x - (wx * y + wx * y) - tz * inverse_depth) - across * (wx * x + wz);
        of.x += self.free[0].select(of_x / axes[0][0], zero);
        of.y += self.free[1].select(of_y / axes[1][0], zero);
        of.depth -= (across * self.pull[0] + down * self.pull[1]) * inverse_depth * inverse_depth;
        [
            -(across * x * y) - down * (one + y * y),
            across * (one + x * x) + down * x * y,
            down * x - across * y,
            across * inverse_depth,
            down * inverse_depth,
            -(across * x + down * y) * inverse_depth,
        ]
    }
}

/// Gradients of a map by a rolling shutter.
struct RolledGrad<L> {
    ellipse: EllipseSimd<L>,
    velocity: [L; 2],
}

/// A map of an ellipse by a rolling shutter, and its parts that the derivative needs.
pub(super) struct RolledSimd<S: Simd, F: Real> {
    /// Velocity over the picture's height.
    shares: [Lanes<S, F>; 2],
    /// Whether the vertical velocity is not clamped.
    free: MaskOf<S, F>,
    k: Lanes<S, F>,
    q: Lanes<S, F>,
    /// `y − H/2`, and times `k`.
    below: Lanes<S, F>,
    lag: Lanes<S, F>,
    sigma_u: Lanes<S, F>,
    /// Row 0 of `M L`, `sigma_u` and `sigma_v` over the new `sigma_u`.
    along: Lanes<S, F>,
    across: Lanes<S, F>,
    share: Lanes<S, F>,
    ratio: Lanes<S, F>,
    /// The new shear over `k`.
    turned: Lanes<S, F>,
}

impl<S: Simd, F: Real> RolledSimd<S, F> {
    #[inline(always)]
    pub fn new(e: &EllipseSimd<Lanes<S, F>>, velocity: [Lanes<S, F>; 2], height: Lanes<S, F>) -> Self {
        let simd = e.x.token();
        let (one, largest) = (lanes::<S, F>(simd, F::ONE), lanes::<S, F>(simd, F::of(LARGEST_SHARE)));
        let vertical = velocity[1] / height;
        let shares = [velocity[0] / height, vertical.max(-largest).min(largest)];
        let k = one / (one - shares[1]);
        let q = k * shares[0];
        let below = e.y - height * F::of(0.5);
        let row = [e.sigma_u * (one + q * e.shear), q * e.sigma_v];
        let sigma_u = hypotenuse::<S, F>(row[0], row[1]);
        let [along, across, share, ratio] = each!([row[0], row[1], e.sigma_u, e.sigma_v], |part| part / sigma_u);
        let turned = along * (e.shear * share) + across * ratio;
        let free = vertical.abs().simd_le(largest);
        Self { shares, free, k, q, below, lag: below * k, sigma_u, along, across, share, ratio, turned }
    }

    #[inline(always)]
    pub fn of(&self, e: EllipseSimd<Lanes<S, F>>) -> EllipseSimd<Lanes<S, F>> {
        let &Self { shares, k, lag, sigma_u, share, turned, .. } = self;
        let (x, y) = (e.x + shares[0] * lag, e.y + shares[1] * lag);
        EllipseSimd { x, y, sigma_u, shear: k * turned, sigma_v: k * e.sigma_v * share, ..e }
    }

    /// Returns the gradients of the ellipse and of the velocity.
    #[inline(always)]
    fn backward(
        &self,
        e: &EllipseSimd<Lanes<S, F>>,
        grad: &EllipseSimd<Lanes<S, F>>,
        height: Lanes<S, F>,
    ) -> RolledGrad<Lanes<S, F>> {
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
        let ellipse = EllipseSimd {
            y: grad.y + grad_lag * k,
            sigma_u: grad.sigma_u * along * (q * e.shear + F::ONE) - twisted * ratio
                + grad_narrow * ratio * across * across,
            shear: grad.sigma_u * along * e.sigma_u * q
                + grad_turned * share * share * (along * along - across * across)
                - grad_narrow * e.sigma_v * share * share * along * q,
            sigma_v: grad.sigma_u * across * q + twisted * share + grad_narrow * share * along * along,
            ..*grad
        };
        let down = self.free.select(grad_down / height, lanes::<S, F>(height.token(), F::ZERO));
        RolledGrad { ellipse, velocity: [(grad.x * self.lag + grad_q * k) / height, down] }
    }
}

/// Constants and the motion of a change.
pub(super) struct ChangeSimd<S: Simd, F: Real> {
    exposure: Exposure,
    axes: [[Lanes<S, F>; 4]; 2],
    height: Lanes<S, F>,
    twist: [Lanes<S, F>; PARAMETERS],
}

impl<S: Simd, F: Real> ChangeSimd<S, F> {
    #[inline(always)]
    pub fn new(simd: S, twist: &[F], spec: &OpticsSpec) -> Self {
        Self {
            exposure: spec.exposure,
            axes: each!(spec.axes(), |axis| each!(axis, |value| lanes::<S, F>(simd, F::of(value)))),
            height: lanes::<S, F>(simd, F::of(spec.intrinsics.height as f64)),
            twist: each!([0, 1, 2, 3, 4, 5], |i| lanes::<S, F>(simd, twist[i])),
        }
    }

    /// The deviation of a motion blur with this velocity.
    #[inline(always)]
    fn blur(velocity: [Lanes<S, F>; 2]) -> [Lanes<S, F>; 2] {
        each!(velocity, |v| v * F::of(1.0 / 12_f64.sqrt()))
    }

    /// Returns changed ellipses; those of culled Gaussians stay.
    #[inline(always)]
    pub fn of(&self, e: EllipseSimd<Lanes<S, F>>) -> EllipseSimd<Lanes<S, F>> {
        let velocity = MovingSimd::<S, F>::new(&e, &self.twist, &self.axes).velocity;
        let found = match self.exposure {
            Exposure::MotionBlur => WidenedSimd::<S, F>::new(&e, Self::blur(velocity)).of(e),
            Exposure::RollingShutter => RolledSimd::<S, F>::new(&e, velocity, self.height).of(e),
        };
        Self::kept(&e, found, e)
    }

    /// Returns `found`, and `other` in the lanes of culled Gaussians.
    #[inline(always)]
    fn kept(
        e: &EllipseSimd<Lanes<S, F>>,
        found: EllipseSimd<Lanes<S, F>>,
        other: EllipseSimd<Lanes<S, F>>,
    ) -> EllipseSimd<Lanes<S, F>> {
        let culled = e.depth.simd_eq(lanes::<S, F>(e.depth.token(), F::ZERO));
        let (found, other) = (found.to_row(), other.to_row());
        EllipseSimd::of_row(each!([0, 1, 2, 3, 4, 5, 6], |column| culled.select(other[column], found[column])))
    }

    /// Returns the gradients of the ellipses, and adds those of the twist.
    #[inline(always)]
    pub fn backward(
        &self,
        e: &EllipseSimd<Lanes<S, F>>,
        grad: &EllipseSimd<Lanes<S, F>>,
        sums: &mut [Lanes<S, F>; PARAMETERS],
    ) -> EllipseSimd<Lanes<S, F>> {
        let moving = MovingSimd::<S, F>::new(e, &self.twist, &self.axes);
        let (mut ellipse, of_velocity) = match self.exposure {
            Exposure::MotionBlur => {
                let WidenedGrad { ellipse, w } =
                    WidenedSimd::<S, F>::new(e, Self::blur(moving.velocity)).backward(e, grad);
                (ellipse, Self::blur(w))
            }
            Exposure::RollingShutter => {
                let RolledGrad { ellipse, velocity } =
                    RolledSimd::<S, F>::new(e, moving.velocity, self.height).backward(e, grad, self.height);
                (ellipse, velocity)
            }
        };
        let of_twist = moving.backward(&self.twist, &self.axes, of_velocity, &mut ellipse);
        let zero = lanes::<S, F>(e.depth.token(), F::ZERO);
        let culled = e.depth.simd_eq(zero);
        for (sum, value) in sums.iter_mut().zip(of_twist) {
            *sum += culled.select(zero, value);
        }
        Self::kept(e, ellipse, *grad)
    }
}
