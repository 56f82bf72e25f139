//! Camera models as COLMAP writes them, over dual numbers (forward-mode differentiation): a value and its derivatives with respect
//! to x, y and z of the camera's frame. The formulas are not simplified.

use std::ops::{Add, Div, Mul, Sub};

use glam::{DMat2, DVec2, DVec3};
use splat_op::{CameraModel, Intrinsics};

use super::ray::Ray;

/// Dual number: a value and its gradient with respect to `(x, y, z)`.
#[derive(Clone, Copy, Debug)]
pub struct Dual {
    pub value: f64,
    pub grad: DVec3,
}

fn number(value: f64) -> Dual {
    Dual { value, grad: DVec3::ZERO }
}

impl Dual {
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        Self { value: root, grad: self.grad / (2.0 * root) }
    }

    fn atan(self) -> Self {
        Self { value: self.value.atan(), grad: self.grad / (1.0 + self.value * self.value) }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, grad: self.grad + other.grad }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { value: self.value - other.value, grad: self.grad - other.grad }
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { value: self.value * other.value, grad: self.value * other.grad + other.value * self.grad }
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let quotient = self.value / other.value;
        Self { value: quotient, grad: (self.grad - quotient * other.grad) / other.value }
    }
}

/// Projects a point of the camera's frame to its position, px, with the Jacobian; `None` outside the lens's domain.
pub(super) fn seen(camera: &Intrinsics, point: DVec3) -> Option<[Dual; 2]> {
    seen_within(camera, camera.max_radius(), point)
}

/// [`seen`] with a known radius of the domain.
fn seen_within(camera: &Intrinsics, max_radius: f64, point: DVec3) -> Option<[Dual; 2]> {
    let axis = |value, grad| Dual { value, grad };
    let [x, y, z] = [axis(point.x, DVec3::X), axis(point.y, DVec3::Y), axis(point.z, DVec3::Z)];
    let (mut u, mut v) = if camera.model == CameraModel::Orthographic { (x, y) } else { (x / z, y / z) };
    // On the axis angles equal slopes, derivatives included, and the formula is 0/0.
    if camera.model.is_fisheye() && (point.x != 0.0 || point.y != 0.0) {
        let r = (u * u + v * v).sqrt();
        let theta = r.atan();
        (u, v) = (u * theta / r, v * theta / r);
    }
    if u.value.hypot(v.value) >= max_radius {
        return None;
    }
    let (r2, c, one, two) = (u * u + v * v, camera.distortion.map(number), number(1.0), number(2.0));
    let (r4, r6, r8) = (r2 * r2, r2 * r2 * r2, r2 * r2 * r2 * r2);
    let tangential =
        |p1: Dual, p2: Dual| [two * p1 * u * v + p2 * (r2 + two * u * u), two * p2 * u * v + p1 * (r2 + two * v * v)];
    let (radial, [du, dv]) = match camera.model {
        CameraModel::Pinhole | CameraModel::Orthographic => (one, [number(0.0); 2]),
        CameraModel::OpenCv => {
            let [k1, k2, p1, p2, ..] = c;
            (one + k1 * r2 + k2 * r4, tangential(p1, p2))
        }
        CameraModel::FullOpenCv => {
            let [k1, k2, p1, p2, k3, k4, k5, k6] = c;
            let above = one + k1 * r2 + k2 * r4 + k3 * r6;
            (above / (one + k4 * r2 + k5 * r4 + k6 * r6), tangential(p1, p2))
        }
        CameraModel::Fisheye => {
            let [k1, k2, k3, k4, ..] = c;
            (one + k1 * r2 + k2 * r4 + k3 * r6 + k4 * r8, [number(0.0); 2])
        }
        CameraModel::ThinPrismFisheye => {
            let [k1, k2, p1, p2, k3, k4, sx1, sy1] = c;
            let [du, dv] = tangential(p1, p2);
            (one + k1 * r2 + k2 * r4 + k3 * r6 + k4 * r8, [du + sx1 * r2, dv + sy1 * r2])
        }
        other => panic!("the exact renderer has no projection of {other:?}: write it here"),
    };
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(number);
    Some([fx * (u * radial + du) + cx, fy * (v * radial + dv) + cy])
}

/// Returns the ray that is projected to a position, px; `None` if there is none. Its direction has a z of one.
pub(super) fn ray(camera: &Intrinsics, pixel: DVec2) -> Option<Ray> {
    if camera.model == CameraModel::Orthographic {
        let origin = (pixel - DVec2::new(camera.cx, camera.cy)) / DVec2::new(camera.fx, camera.fy);
        return Some(Ray { origin: origin.extend(0.0), direction: DVec3::Z });
    }
    direction(camera, pixel).map(|direction| Ray { origin: DVec3::ZERO, direction })
}

/// Returns the direction from the camera's centre. Newton's method from the directions of a coarse grid, because the projection of a
/// strong lens folds outside its domain.
fn direction(camera: &Intrinsics, pixel: DVec2) -> Option<DVec3> {
    // For an angle θ, a fisheye's projection is far closer to linear in θ than in tan θ.
    let (fisheye, max_radius) = (camera.model.is_fisheye(), camera.max_radius());
    let ray = |s: DVec2| {
        let angle = s.length();
        if fisheye && angle > 0.0 { (s * (angle.tan() / angle)).extend(1.0) } else { s.extend(1.0) }
    };
    let ahead = |s: DVec2| !fisheye || s.length() < std::f64::consts::FRAC_PI_2;
    let seen_at = |s: DVec2| {
        let [u, v] = seen_within(camera, max_radius, ray(s)).filter(|_| ahead(s))?;
        Some(DVec2::new(u.value, v.value))
    };
    let solve = |start: DVec2| {
        let mut s = start;
        let mut error = seen_at(s)? - pixel;
        for _ in 0..50 {
            // Central differences are enough for the steps; the end is judged by the projection itself.
            let h = 1e-6;
            let slope = |step: DVec2| Some((seen_at(s + h * step)? - seen_at(s - h * step)?) / (2.0 * h));
            let step = DMat2::from_cols(slope(DVec2::X)?, slope(DVec2::Y)?).inverse() * error;
            // A step that leads away from the position is halved.
            let shorter = (0..16).find_map(|halvings| {
                let next = s - step * 0.5_f64.powi(halvings);
                let left = seen_at(next)? - pixel;
                (left.length() < error.length()).then_some((next, left))
            });
            let Some((next, left)) = shorter else { break };
            (s, error) = (next, left);
        }
        (error.length() < 1e-9 * (1.0 + pixel.length())).then(|| ray(s))
    };
    let coarse = [0.0, 0.6, -0.6];
    coarse.into_iter().flat_map(|x| coarse.map(|y| DVec2::new(x, y))).find_map(solve)
}
