//! Changes of an ellipse and their gradients, for the kernels and the CPU twin. They mean nothing for culled Gaussians.

use super::{LARGEST_SHARE, OpticsEffect, PARAMETERS};
use crate::linalg::Number;
use crate::project::Ellipse;
use crate::simd::each;

/// Constants and the motion of a change.
pub(super) struct Change<N> {
    pub exposure: OpticsEffect,
    /// As of [`OpticsSpec::axes`](super::OpticsSpec::axes).
    pub axes: [[N; 4]; 2],
    /// Height of the picture, px.
    pub height: N,
    pub twist: [N; PARAMETERS],
}

impl<N: Number> Change<N> {
    #[inline(always)]
    pub fn of(&self, e: &Ellipse<N>) -> Ellipse<N> {
        let velocity = Moving::new(e, self).velocity;
        match self.exposure {
            OpticsEffect::MotionBlur => Widened::new(e, blur(velocity)).of(e),
            OpticsEffect::RollingShutter => Rolled::new(e, velocity, self.height).of(e),
        }
    }

    /// Returns the gradients of the ellipse and of the twist.
    #[inline(always)]
    pub fn backward(&self, e: &Ellipse<N>, grad: &Ellipse<N>) -> (Ellipse<N>, [N; PARAMETERS]) {
        let moving = Moving::new(e, self);
        let (of_ellipse, of_velocity) = match self.exposure {
            OpticsEffect::MotionBlur => {
                let (of_ellipse, w) = Widened::new(e, blur(moving.velocity)).backward(e, grad);
                (of_ellipse, blur(w))
            }
            OpticsEffect::RollingShutter => Rolled::new(e, moving.velocity, self.height).backward(e, grad, self.height),
        };
        moving.backward(self, of_velocity, of_ellipse)
    }
}

/// The deviation of a motion blur with this velocity.
#[inline(always)]
fn blur<N: Number>(velocity: [N; 2]) -> [N; 2] {
    each!(velocity, |v| v * (1.0 / 12_f64.sqrt()))
}

/// A widening by `w wᵀ`, and its parts that the derivative needs.
pub(super) struct Widened<N> {
    w: [N; 2],
    sigma_u: N,
    sigma_v: N,
    /// `sigma_u`, `w_x` and `w_y` over the new `sigma_u`.
    share: N,
    across: N,
    along: N,
    /// `w_y − shear w_x`.
    off: N,
}

impl<N: Number> Widened<N> {
    #[inline(always)]
    pub fn new(e: &Ellipse<N>, w: [N; 2]) -> Self {
        let sigma_u = e.sigma_u.hypotenuse(w[0]);
        let [share, across, along] = each!([e.sigma_u, w[0], w[1]], |part| part / sigma_u);
        let off = w[1] - e.shear * w[0];
        Self { w, sigma_u, sigma_v: e.sigma_v.hypotenuse(share * off), share, across, along, off }
    }

    #[inline(always)]
    pub fn of(&self, e: &Ellipse<N>) -> Ellipse<N> {
        let &Self { sigma_u, sigma_v, share, across, along, .. } = self;
        let shear = share * share * e.shear + across * along;
        Ellipse { sigma_u, shear, sigma_v, opacity: e.opacity * share * (e.sigma_v / sigma_v), ..*e }
    }

    /// Returns the gradients of the ellipse and of `w`.
    #[inline(always)]
    pub fn backward(&self, e: &Ellipse<N>, grad: &Ellipse<N>) -> (Ellipse<N>, [N; 2]) {
        let &Self { share, across, along, off, .. } = self;
        let one = off.constant(1.0);
        let [of_u, of_v] = [one / self.sigma_u, one / self.sigma_v];
        // The parts of the new `sigma_v`, whose squares add up to one.
        let [kept, slanted] = each!([e.sigma_v, share * off], |part| part * of_v);
        let grad_kept = grad.opacity * e.opacity * share;
        let grad_v = grad.sigma_v - grad_kept * kept * of_v;
        let grad_slanted = grad_v * slanted;
        let grad_off = grad_slanted * share;
        let grad_share = grad.opacity * e.opacity * kept + grad_slanted * off + grad.shear * 2.0 * share * e.shear;
        let (grad_across, grad_along) = (grad.shear * along, grad.shear * across);
        // `share` and `across` are the sides of a triangle of length one: what changes both alike changes neither.
        let turned = (grad_across * share - grad_share * across) * of_u;
        let radial = grad.sigma_u - grad_along * along * of_u;
        let ellipse = Ellipse {
            sigma_u: radial * share - turned * across,
            shear: grad.shear * share * share - grad_off * self.w[0],
            sigma_v: grad.sigma_v * kept + grad_kept * slanted * slanted * of_v,
            opacity: grad.opacity * share * kept,
            ..*grad
        };
        (ellipse, [radial * across + turned * share - grad_off * e.shear, grad_off + grad_along * of_u])
    }
}

/// The motion of a centre, and its parts that the derivative needs.
pub(super) struct Moving<N: Number> {
    /// px.
    pub velocity: [N; 2],
    slope: [N; 2],
    /// Whether the centre is not clamped.
    free: [N::Mask; 2],
    inverse_depth: N,
    /// `τ − s τ_z`.
    pull: [N; 2],
}

impl<N: Number> Moving<N> {
    #[inline(always)]
    pub fn new(e: &Ellipse<N>, change: &Change<N>) -> Self {
        let Change { twist: [wx, wy, wz, tx, ty, tz], axes, .. } = *change;
        let one = e.depth.constant(1.0);
        let inverse_depth = one / e.depth;
        let at = each!([0, 1], |axis| e.mean_px[axis].max(axes[axis][2]).min(axes[axis][3]));
        let [x, y] = each!([0, 1], |axis| (at[axis] - axes[axis][1]) / axes[axis][0]);
        let pull = [tx - x * tz, ty - y * tz];
        let across = pull[0] * inverse_depth + wy * (one + x * x) - wx * x * y - wz * y;
        let down = pull[1] * inverse_depth - wx * (one + y * y) + wy * x * y + wz * x;
        Self {
            velocity: [axes[0][0] * across, axes[1][0] * down],
            slope: [x, y],
            free: each!([0, 1], |axis| at[axis].eq(e.mean_px[axis])),
            inverse_depth,
            pull,
        }
    }

    /// Returns the gradient of the ellipse, with what the velocity adds to `of`, and that of the twist.
    #[inline(always)]
    fn backward(&self, change: &Change<N>, grad: [N; 2], of: Ellipse<N>) -> (Ellipse<N>, [N; PARAMETERS]) {
        let Change { twist: [wx, wy, wz, _, _, tz], axes, .. } = *change;
        let &Self { slope: [x, y], inverse_depth, .. } = self;
        let (across, down) = (grad[0] * axes[0][0], grad[1] * axes[1][0]);
        let [zero, one] = [x.constant(0.0), x.constant(1.0)];
        let of_x = across * (wy * 2.0 * x - wx * y - tz * inverse_depth) + down * (wy * y + wz);
        let of_y = down * (wy * x - wx * 2.0 * y - tz * inverse_depth) - across * (wx * x + wz);
        let ellipse = Ellipse {
            mean_px: [
                of.mean_px[0] + N::select(self.free[0], of_x / axes[0][0], zero),
                of.mean_px[1] + N::select(self.free[1], of_y / axes[1][0], zero),
            ],
            depth: of.depth - (across * self.pull[0] + down * self.pull[1]) * inverse_depth * inverse_depth,
            ..of
        };
        let of_twist = [
            -(across * x * y) - down * (one + y * y),
            across * (one + x * x) + down * x * y,
            down * x - across * y,
            across * inverse_depth,
            down * inverse_depth,
            -(across * x + down * y) * inverse_depth,
        ];
        (ellipse, of_twist)
    }
}

/// A map of an ellipse by a rolling shutter, and its parts that the derivative needs.
pub(super) struct Rolled<N: Number> {
    /// Velocity over the picture's height.
    shares: [N; 2],
    /// Whether the vertical velocity is not clamped.
    free: N::Mask,
    k: N,
    q: N,
    /// `y − H/2`, and times `k`.
    below: N,
    lag: N,
    sigma_u: N,
    /// Row 0 of `M L`, `sigma_u` and `sigma_v` over the new `sigma_u`.
    along: N,
    across: N,
    share: N,
    ratio: N,
    /// The new shear over `k`.
    turned: N,
}

impl<N: Number> Rolled<N> {
    #[inline(always)]
    pub fn new(e: &Ellipse<N>, velocity: [N; 2], height: N) -> Self {
        let (one, largest) = (height.constant(1.0), height.constant(LARGEST_SHARE));
        let vertical = velocity[1] / height;
        let shares = [velocity[0] / height, vertical.max(-largest).min(largest)];
        let k = one / (one - shares[1]);
        let q = k * shares[0];
        let below = e.mean_px[1] - height * 0.5;
        let row = [e.sigma_u * (one + q * e.shear), q * e.sigma_v];
        let sigma_u = row[0].hypotenuse(row[1]);
        let [along, across, share, ratio] = each!([row[0], row[1], e.sigma_u, e.sigma_v], |part| part / sigma_u);
        let turned = along * (e.shear * share) + across * ratio;
        let free = shares[1].eq(vertical);
        Self { shares, free, k, q, below, lag: below * k, sigma_u, along, across, share, ratio, turned }
    }

    #[inline(always)]
    pub fn of(&self, e: &Ellipse<N>) -> Ellipse<N> {
        let &Self { shares, k, lag, sigma_u, share, turned, .. } = self;
        let mean_px = [e.mean_px[0] + shares[0] * lag, e.mean_px[1] + shares[1] * lag];
        Ellipse { mean_px, sigma_u, shear: k * turned, sigma_v: k * e.sigma_v * share, ..*e }
    }

    /// Returns the gradients of the ellipse and of the velocity.
    #[inline(always)]
    fn backward(&self, e: &Ellipse<N>, grad: &Ellipse<N>, height: N) -> (Ellipse<N>, [N; 2]) {
        let &Self { shares, k, q, lag, sigma_u, along, across, share, ratio, turned, .. } = self;
        let (grad_turned, grad_narrow) = (grad.shear * k, grad.sigma_v * k);
        // Derivatives of `turned` with differences taken by hand: with `c = 1 + q shear`, `c − q shear = 1`.
        let twisted = grad_turned * 2.0 * along * across / sigma_u;
        let squared = share * share;
        let grad_q = grad.sigma_u * turned * sigma_u + grad_turned * (squared * ratio * ratio - turned * turned)
            - grad_narrow * e.sigma_v * share * turned;
        let grad_lag = grad.mean_px[0] * shares[0] + grad.mean_px[1] * shares[1];
        let grad_k = grad.shear * turned + grad.sigma_v * e.sigma_v * share + grad_q * shares[0];
        let grad_k = grad_k + grad_lag * self.below;
        let grad_down = grad.mean_px[1] * lag + grad_k * k * k;
        let ellipse = Ellipse {
            mean_px: [grad.mean_px[0], grad.mean_px[1] + grad_lag * k],
            sigma_u: grad.sigma_u * along * (q * e.shear + 1.0) - twisted * ratio
                + grad_narrow * ratio * across * across,
            shear: grad.sigma_u * along * e.sigma_u * q + grad_turned * squared * (along * along - across * across)
                - grad_narrow * e.sigma_v * squared * along * q,
            sigma_v: grad.sigma_u * across * q + twisted * share + grad_narrow * share * along * along,
            ..*grad
        };
        let down = N::select(self.free, grad_down / height, height.constant(0.0));
        (ellipse, [(grad.mean_px[0] * lag + grad_q * k) / height, down])
    }
}
