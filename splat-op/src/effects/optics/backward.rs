//! Backward kernel of the changes of ellipses: one unit per Gaussian recomputes the change and differentiates it. The gradient of the
//! twist is added over a cube, and its row over the cubes by another kernel.

use cubecl::prelude::*;

use super::forward::{Change, Kind, Moving, Rolled, Twist, Widened, blur, moving, rolled, widened};
use crate::gpu::UNITS;
use crate::gpu::math::{Vec2, Vec3};
use crate::gpu::reduce::cube_sum;
use crate::project::forward::PackedEllipse;

/// Returns the gradients of the ellipse and of `w`.
#[cube]
fn widened_backward(f: &Widened, e: &PackedEllipse, grad: &PackedEllipse) -> (PackedEllipse, Vec2) {
    let (of_u, of_v) = (1.0 / f.sigma_u, 1.0 / f.sigma_v);
    // The parts of the new `sigma_v`, whose squares add up to one.
    let (kept, slanted) = (e.sigma_v * of_v, f.share * f.off * of_v);
    let grad_kept = grad.opacity * e.opacity * f.share;
    let grad_v = grad.sigma_v - grad_kept * kept * of_v;
    let grad_slanted = grad_v * slanted;
    let grad_off = grad_slanted * f.share;
    let grad_share = grad.opacity * e.opacity * kept + grad_slanted * f.off + 2.0 * grad.shear * f.share * e.shear;
    let (grad_across, grad_along) = (grad.shear * f.along, grad.shear * f.across);
    // `share` and `across` are the sides of a triangle of length one: what changes both alike changes neither.
    let turned = (grad_across * f.share - grad_share * f.across) * of_u;
    let radial = grad.sigma_u - grad_along * f.along * of_u;
    let ellipse = PackedEllipse {
        x: grad.x,
        y: grad.y,
        sigma_u: radial * f.share - turned * f.across,
        shear: grad.shear * f.share * f.share - grad_off * f.w.x,
        sigma_v: grad.sigma_v * kept + grad_kept * slanted * slanted * of_v,
        depth: grad.depth,
        opacity: grad.opacity * f.share * kept,
    };
    let w = Vec2::new(radial * f.across + turned * f.share - grad_off * e.shear, grad_off + grad_along * of_u);
    (ellipse, w)
}

/// Returns the gradients of the ellipse and of the velocity.
#[cube]
fn rolled_backward(f: &Rolled, e: &PackedEllipse, grad: &PackedEllipse, height: f32) -> (PackedEllipse, Vec2) {
    let (grad_turned, grad_narrow) = (grad.shear * f.k, grad.sigma_v * f.k);
    // Derivatives of `turned` with differences taken by hand: with `c = 1 + q shear`, `c − q shear = 1`.
    let twisted = 2.0 * grad_turned * f.along * f.across / f.sigma_u;
    let grad_q = grad.sigma_u * f.turned * f.sigma_u
        + grad_turned * (f.share * f.share * f.ratio * f.ratio - f.turned * f.turned)
        - grad_narrow * e.sigma_v * f.share * f.turned;
    let grad_lag = grad.x * f.shares.x + grad.y * f.shares.y;
    let grad_k = grad.shear * f.turned + grad.sigma_v * e.sigma_v * f.share + grad_q * f.shares.x;
    let grad_k = grad_k + grad_lag * f.below;
    let grad_down = grad.y * f.lag + grad_k * f.k * f.k;
    let shared = f.share * f.share;
    let ellipse = PackedEllipse {
        x: grad.x,
        y: grad.y + grad_lag * f.k,
        sigma_u: grad.sigma_u * f.along * (1.0 + f.q * e.shear) - twisted * f.ratio
            + grad_narrow * f.ratio * f.across * f.across,
        shear: grad.sigma_u * f.along * e.sigma_u * f.q
            + grad_turned * shared * (f.along * f.along - f.across * f.across)
            - grad_narrow * e.sigma_v * shared * f.along * f.q,
        sigma_v: grad.sigma_u * f.across * f.q + twisted * f.share + grad_narrow * f.share * f.along * f.along,
        depth: grad.depth,
        opacity: grad.opacity,
    };
    (ellipse, Vec2::new((grad.x * f.lag + grad_q * f.k) / height, select(f.free, grad_down / height, 0.0)))
}

/// Returns the gradient of the ellipse, with what the velocity adds to `of`, and that of the twist.
#[cube]
fn moving_backward(
    f: &Moving,
    twist: &Twist,
    change: &Change,
    grad: Vec2,
    of: &PackedEllipse,
) -> (PackedEllipse, Twist) {
    let (turn, tz) = (twist.turn, twist.shift.z);
    let (x, y, inverse) = (f.slope.x, f.slope.y, f.inverse_depth);
    let (across, down) = (grad.x * change.x.focal, grad.y * change.y.focal);
    let of_x = across * (2.0 * turn.y * x - turn.x * y - tz * inverse) + down * (turn.y * y + turn.z);
    let of_y = down * (turn.y * x - 2.0 * turn.x * y - tz * inverse) - across * (turn.x * x + turn.z);
    let ellipse = PackedEllipse {
        x: of.x + select(f.free_x, of_x / change.x.focal, 0.0),
        y: of.y + select(f.free_y, of_y / change.y.focal, 0.0),
        sigma_u: of.sigma_u,
        shear: of.shear,
        sigma_v: of.sigma_v,
        depth: of.depth - (across * f.pull.x + down * f.pull.y) * inverse * inverse,
        opacity: of.opacity,
    };
    let of_twist = Twist {
        turn: Vec3::new(
            -(across * x * y) - down * (1.0 + y * y),
            across * (1.0 + x * x) + down * x * y,
            down * x - across * y,
        ),
        shift: Vec3::new(across * inverse, down * inverse, -(across * x + down * y) * inverse),
    };
    (ellipse, of_twist)
}

/// Writes the gradients of the ellipses, `[N, 7]`, and one row per cube of that of the twist, `[cubes, 6]`.
#[cube(launch_unchecked)]
pub(super) fn expose_backward_kernel(
    projected: &[f32],
    twist: &[f32],
    grad: &[f32],
    of_projected: &mut [f32],
    rows: &mut [f32],
    change: Change,
    count: u32,
) {
    let zero = 0.0f32.runtime();
    let nothing = Vec3::new(zero, zero, zero);
    let mut turn = nothing;
    let mut shift = nothing;
    if ABSOLUTE_POS < count as usize {
        let e = PackedEllipse::load(projected, ABSOLUTE_POS);
        let grad = PackedEllipse::load(grad, ABSOLUTE_POS);
        if e.depth == 0.0 {
            grad.store(of_projected, ABSOLUTE_POS);
        } else {
            let twist = Twist::load(twist);
            let motion = moving(&e, &twist, &change);
            let (of, velocity) = if comptime!(change.kind == Kind::MotionBlur) {
                let (of, w) = widened_backward(&widened(&e, blur(motion.velocity)), &e, &grad);
                (of, blur(w))
            } else {
                rolled_backward(&rolled(&e, motion.velocity, change.height), &e, &grad, change.height)
            };
            let (of, of_twist) = moving_backward(&motion, &twist, &change, velocity, &of);
            of.store(of_projected, ABSOLUTE_POS);
            turn = of_twist.turn;
            shift = of_twist.shift;
        }
    }
    // A dispatch may hold more cubes than there are rows.
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS * comptime!(UNITS) < count as usize {
        let row = CUBE_POS * 6;
        store_sum(turn.x, rows, row, &mut shared);
        store_sum(turn.y, rows, row + 1, &mut shared);
        store_sum(turn.z, rows, row + 2, &mut shared);
        store_sum(shift.x, rows, row + 3, &mut shared);
        store_sum(shift.y, rows, row + 4, &mut shared);
        store_sum(shift.z, rows, row + 5, &mut shared);
    }
}

/// Writes the sum over the units of a cube to an element.
#[cube]
fn store_sum(value: f32, to: &mut [f32], at: usize, shared: &mut Shared<[f32]>) {
    let sum = cube_sum(value, shared);
    if UNIT_POS == 0 {
        to[at] = sum;
    }
}
