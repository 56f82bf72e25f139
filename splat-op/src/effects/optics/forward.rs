//! Forward kernel of the changes of ellipses: one unit per Gaussian.

use cubecl::prelude::*;

use super::LARGEST_SHARE;
use crate::gpu::math::{Vec2, Vec3, within};
use crate::project::forward::PackedEllipse;

/// Which change a kernel makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Kind {
    MotionBlur,
    RollingShutter,
}

/// One axis of the picture, px.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Axis {
    pub focal: f32,
    pub principal: f32,
    /// Limits to which a centre is clamped for its velocity.
    pub low: f32,
    pub high: f32,
}

/// Camera and change as arguments of the kernels.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Change {
    pub x: Axis,
    pub y: Axis,
    /// px.
    pub height: f32,
    #[cube(comptime)]
    pub kind: Kind,
}

/// A motion, from a tensor.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Twist {
    pub turn: Vec3,
    pub shift: Vec3,
}

#[cube]
impl Twist {
    pub fn load(from: &[f32]) -> Twist {
        Twist { turn: Vec3::load(from, 0), shift: Vec3::load(from, 3) }
    }
}

/// The twin's `MovingSimd`.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Moving {
    pub velocity: Vec2,
    pub slope: Vec2,
    pub free_x: bool,
    pub free_y: bool,
    pub inverse_depth: f32,
    pub pull: Vec2,
}

#[cube]
pub(super) fn moving(e: &PackedEllipse, twist: &Twist, change: &Change) -> Moving {
    let inverse_depth = 1.0 / e.depth;
    let (at_x, at_y) = (within(e.x, change.x.low, change.x.high), within(e.y, change.y.low, change.y.high));
    let x = (at_x - change.x.principal) / change.x.focal;
    let y = (at_y - change.y.principal) / change.y.focal;
    let (turn, shift) = (twist.turn, twist.shift);
    let pull = Vec2::new(shift.x - x * shift.z, shift.y - y * shift.z);
    let across = pull.x * inverse_depth + turn.y * (1.0 + x * x) - turn.x * x * y - turn.z * y;
    let down = pull.y * inverse_depth - turn.x * (1.0 + y * y) + turn.y * x * y + turn.z * x;
    Moving {
        velocity: Vec2::new(change.x.focal * across, change.y.focal * down),
        slope: Vec2::new(x, y),
        free_x: at_x == e.x,
        free_y: at_y == e.y,
        inverse_depth,
        pull,
    }
}

/// The twin's `WidenedSimd`.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Widened {
    pub w: Vec2,
    pub sigma_u: f32,
    pub sigma_v: f32,
    pub share: f32,
    pub across: f32,
    pub along: f32,
    pub off: f32,
}

#[cube]
pub(super) fn widened(e: &PackedEllipse, w: Vec2) -> Widened {
    let sigma_u = Vec3::new(e.sigma_u, w.x, 0.0).length();
    let share = e.sigma_u / sigma_u;
    let off = w.y - e.shear * w.x;
    Widened {
        w,
        sigma_u,
        sigma_v: Vec3::new(e.sigma_v, share * off, 0.0).length(),
        share,
        across: w.x / sigma_u,
        along: w.y / sigma_u,
        off,
    }
}

#[cube]
impl Widened {
    fn of(&self, e: &PackedEllipse) -> PackedEllipse {
        PackedEllipse {
            x: e.x,
            y: e.y,
            sigma_u: self.sigma_u,
            shear: self.share * self.share * e.shear + self.across * self.along,
            sigma_v: self.sigma_v,
            depth: e.depth,
            opacity: e.opacity * self.share * (e.sigma_v / self.sigma_v),
        }
    }
}

/// The deviation of a motion blur with this velocity.
#[cube]
pub(super) fn blur(velocity: Vec2) -> Vec2 {
    velocity.times(comptime!((1.0 / 12_f64.sqrt()) as f32))
}

/// The twin's `RolledSimd`.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Rolled {
    pub shares: Vec2,
    pub free: bool,
    pub k: f32,
    pub q: f32,
    pub below: f32,
    pub lag: f32,
    pub sigma_u: f32,
    pub along: f32,
    pub across: f32,
    pub share: f32,
    pub ratio: f32,
    pub turned: f32,
}

#[cube]
pub(super) fn rolled(e: &PackedEllipse, velocity: Vec2, height: f32) -> Rolled {
    let largest = comptime!(LARGEST_SHARE as f32);
    let vertical = velocity.y / height;
    let down = within(vertical, -largest, largest);
    let right = velocity.x / height;
    let k = 1.0 / (1.0 - down);
    let q = k * right;
    let below = e.y - 0.5 * height;
    let (row_u, row_v) = (e.sigma_u * (1.0 + q * e.shear), q * e.sigma_v);
    let sigma_u = Vec3::new(row_u, row_v, 0.0).length();
    let (along, across) = (row_u / sigma_u, row_v / sigma_u);
    let (share, ratio) = (e.sigma_u / sigma_u, e.sigma_v / sigma_u);
    Rolled {
        shares: Vec2::new(right, down),
        free: down == vertical,
        k,
        q,
        below,
        lag: below * k,
        sigma_u,
        along,
        across,
        share,
        ratio,
        turned: along * (e.shear * share) + across * ratio,
    }
}

#[cube]
impl Rolled {
    fn of(&self, e: &PackedEllipse) -> PackedEllipse {
        PackedEllipse {
            x: e.x + self.shares.x * self.lag,
            y: e.y + self.shares.y * self.lag,
            sigma_u: self.sigma_u,
            shear: self.k * self.turned,
            sigma_v: self.k * e.sigma_v * self.share,
            depth: e.depth,
            opacity: e.opacity,
        }
    }
}

#[cube(launch_unchecked)]
pub(super) fn expose_kernel(projected: &[f32], twist: &[f32], out: &mut [f32], change: Change, count: u32) {
    if ABSOLUTE_POS < count as usize {
        let e = PackedEllipse::load(projected, ABSOLUTE_POS);
        if e.depth == 0.0 {
            e.store(out, ABSOLUTE_POS);
        } else {
            let motion = moving(&e, &Twist::load(twist), &change);
            if comptime!(change.kind == Kind::MotionBlur) {
                widened(&e, blur(motion.velocity)).of(&e).store(out, ABSOLUTE_POS);
            } else {
                rolled(&e, motion.velocity, change.height).of(&e).store(out, ABSOLUTE_POS);
            }
        }
    }
}
