//! Lenses in the kernels of `project`, forward: the arithmetic of the contract in `lens.rs`.

use cubecl::prelude::*;

use super::axis::{CameraAxis, JacobianRow};
use super::lens::HALF_ANGLE_F32;
use crate::camera::CameraModel;
use crate::gpu::math::{Mat3, Vec2, Vec3, within};

/// A lens's planar map.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Distortion {
    /// Coefficients of the numerator and of the denominator of `g`.
    pub k1: f32,
    pub k2: f32,
    pub k3: f32,
    pub k4: f32,
    pub d1: f32,
    pub d2: f32,
    pub d3: f32,
    /// `P` and `S` of the contract.
    pub tangential: Vec2,
    pub prism: Vec2,
    /// Square of the radius of the lens's domain; Gaussians at or beyond that radius are culled.
    pub max_radius_squared: f32,
    #[cube(comptime)]
    pub model: CameraModel,
}

/// 2 × 2 matrix by its rows.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Mat2 {
    pub x: Vec2,
    pub y: Vec2,
}

#[cube]
impl Mat2 {
    /// `A v`.
    pub fn apply(&self, v: Vec2) -> Vec2 {
        Vec2 { x: self.x.dot(v), y: self.y.dot(v) }
    }

    /// `Aᵀ v`.
    pub fn apply_transposed(&self, v: Vec2) -> Vec2 {
        self.x.times(v.x).plus(self.y.times(v.y))
    }
}

/// `g` and its first two derivatives.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Radial {
    value: f32,
    slope: f32,
    bend: f32,
}

/// The planar map and its derivatives at one position.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct PlanarMap {
    pub s: Vec2,
    pub value: Vec2,
    /// `A` of the contract.
    pub by: Mat2,
    /// `g'` and `g''`.
    pub slope: f32,
    pub bend: f32,
}

#[cube]
impl Distortion {
    fn radial(&self, w: f32) -> Radial {
        let value = 1.0 + w * (self.k1 + w * (self.k2 + w * (self.k3 + w * self.k4)));
        let slope = self.k1 + w * (2.0 * self.k2 + w * (3.0 * self.k3 + w * (4.0 * self.k4)));
        let bend = 2.0 * self.k2 + w * (6.0 * self.k3 + w * (12.0 * self.k4));
        if comptime!(matches!(self.model, CameraModel::FullOpenCv)) {
            let inverse = 1.0 / (1.0 + w * (self.d1 + w * (self.d2 + w * self.d3)));
            let below = self.d1 + w * (2.0 * self.d2 + w * (3.0 * self.d3));
            let below_bend = 2.0 * self.d2 + w * (6.0 * self.d3);
            let value = value * inverse;
            let slope = (slope - value * below) * inverse;
            Radial { value, slope, bend: (bend - 2.0 * slope * below - value * below_bend) * inverse }
        } else {
            Radial { value, slope, bend }
        }
    }

    pub fn at(&self, s: Vec2) -> PlanarMap {
        let w = s.dot(s);
        let g = self.radial(w);
        let p = self.tangential;
        let twice = 2.0 * p.dot(s);
        // `2 (g' s + P)`, which each row of `A` contains times `s`, and `2 (P + S)`.
        let inward = s.times(2.0 * g.slope).plus(p.times(2.0));
        let outward = p.plus(self.prism);
        let diagonal = g.value + twice;
        let (x, y) = (2.0 * outward.x, 2.0 * outward.y);
        PlanarMap {
            s,
            value: s.times(diagonal).plus(outward.times(w)),
            by: Mat2 {
                x: Vec2::new(diagonal + s.x * inward.x + x * s.x, s.x * inward.y + x * s.y),
                y: Vec2::new(s.y * inward.x + y * s.x, diagonal + s.y * inward.y + y * s.y),
            },
            slope: g.slope,
            bend: g.bend,
        }
    }
}

/// Intermediate values of the first step of a perspective lens, for the backward pass.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Perspective {
    pub ratio: Vec2,
    pub free_x: bool,
    pub free_y: bool,
    pub inverse_depth: f32,
}

/// Intermediate values of the first step of a fisheye, for the backward pass, under the names of the contract.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Fisheye {
    pub p: Vec2,
    pub c: f32,
    pub alpha: f32,
    pub beta: f32,
    pub delta: f32,
    /// `β p·row − last` and `p·row`.
    pub lean: Vec3,
    pub across: Vec3,
    pub inverse_length: f32,
}

/// Projection of a centre through a lens, with the intermediate values that the gradient needs.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct LensProjection {
    /// Whether the centre lies within the lens's domain.
    pub within: bool,
    /// The planar map at the centre, and at the position at which the Jacobian is evaluated.
    pub centre: PlanarMap,
    pub held: PlanarMap,
    /// `b₀, b₁`, and `W R`.
    pub base_x: Vec3,
    pub base_y: Vec3,
    pub rows: Mat3,
    /// Terms of the first step; an orthographic camera's has none.
    pub perspective: ComptimeOption<Perspective>,
    pub fisheye: ComptimeOption<Fisheye>,
}

/// Gradients of `W R` and of the centre in the camera's frame.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct SeenGrad {
    pub turned: Mat3,
    pub centre: Vec3,
}

/// Projections of a Gaussian along both axes of the picture, from its centre in the camera's frame and `W R`.
#[cube]
pub(crate) fn bent_rows(
    mean_cam: Vec3,
    rows: Mat3,
    scale: Vec3,
    x_axis: &CameraAxis,
    y_axis: &CameraAxis,
    distortion: &Distortion,
) -> (JacobianRow, JacobianRow, LensProjection) {
    let bent = if comptime!(distortion.model.is_fisheye()) {
        fisheye(mean_cam, rows, distortion)
    } else if comptime!(matches!(distortion.model, CameraModel::Orthographic)) {
        orthographic(mean_cam, rows, distortion)
    } else {
        perspective(mean_cam, rows, x_axis, y_axis, distortion)
    };
    let (by, focal_x, focal_y) = (bent.held.by, x_axis.focal, y_axis.focal);
    let j_x = bent.base_x.times(focal_x * by.x.x).plus(bent.base_y.times(focal_x * by.x.y));
    let j_y = bent.base_x.times(focal_y * by.y.x).plus(bent.base_y.times(focal_y * by.y.y));
    let (seen_at, s) = (bent.centre.value, bent.held.s);
    let x = JacobianRow { ratio: seen_at.x, slope: s.x, slope_free: false, j: j_x, m: j_x.by_axis(scale) };
    let y = JacobianRow { ratio: seen_at.y, slope: s.y, slope_free: false, j: j_y, m: j_y.by_axis(scale) };
    (x, y, bent)
}

#[cube]
fn perspective(
    mean_cam: Vec3,
    rows: Mat3,
    x_axis: &CameraAxis,
    y_axis: &CameraAxis,
    distortion: &Distortion,
) -> LensProjection {
    let inverse_depth = 1.0 / mean_cam.z;
    let ratio = Vec2::new(mean_cam.x / mean_cam.z, mean_cam.y / mean_cam.z);
    let s = Vec2::new(within(ratio.x, x_axis.low, x_axis.high), within(ratio.y, y_axis.low, y_axis.high));
    let (free_x, free_y) = (s.x == ratio.x, s.y == ratio.y);
    LensProjection {
        within: ratio.dot(ratio) < distortion.max_radius_squared,
        centre: distortion.at(ratio),
        held: distortion.at(s),
        base_x: rows.x.minus(rows.z.times(s.x)).times(inverse_depth),
        base_y: rows.y.minus(rows.z.times(s.y)).times(inverse_depth),
        rows,
        perspective: ComptimeOption::new_Some(Perspective { ratio, free_x, free_y, inverse_depth }),
        fisheye: ComptimeOption::new_None(),
    }
}

#[cube]
fn fisheye(mean_cam: Vec3, rows: Mat3, distortion: &Distortion) -> LensProjection {
    let length = mean_cam.length();
    let (p, c) = (Vec2::new(mean_cam.x / length, mean_cam.y / length), mean_cam.z / length);
    let v = p.dot(p) / ((1.0 + c) * (1.0 + c));
    let h = half_angle(v);
    let third = comptime!(1.0f32 / 3.0);
    let a = v * h - third;
    let more = 1.0 + v;
    let squared = more * more;
    let alpha = more + more * v * a;
    let beta = -(more * (3.0 + v + squared * a) * 0.25);
    let delta = more * (25.0 + v * (9.0 - v * more) + 3.0 * squared * squared * h) * 0.0625;
    let across = rows.x.times(p.x).plus(rows.y.times(p.y));
    let lean = across.times(beta).minus(rows.z);
    let aside = rows.y.times(p.x).minus(rows.x.times(p.y)).times(beta);
    let inverse_length = 1.0 / length;
    let s = p.times(alpha);
    let at = distortion.at(s);
    LensProjection {
        within: s.dot(s) < distortion.max_radius_squared,
        centre: at,
        held: at,
        base_x: rows.x.times(c).plus(aside.times(p.y)).minus(rows.z.times(p.x)).times(inverse_length),
        base_y: rows.y.times(c).minus(aside.times(p.x)).minus(rows.z.times(p.y)).times(inverse_length),
        rows,
        perspective: ComptimeOption::new_None(),
        fisheye: ComptimeOption::new_Some(Fisheye { p, c, alpha, beta, delta, lean, across, inverse_length }),
    }
}

#[cube]
fn orthographic(mean_cam: Vec3, rows: Mat3, distortion: &Distortion) -> LensProjection {
    let s = Vec2::new(mean_cam.x, mean_cam.y);
    let at = distortion.at(s);
    LensProjection {
        within: s.dot(s) < distortion.max_radius_squared,
        centre: at,
        held: at,
        base_x: rows.x,
        base_y: rows.y,
        rows,
        perspective: ComptimeOption::new_None(),
        fisheye: ComptimeOption::new_None(),
    }
}

/// `h` of the contract, for `0 <= v <= 1`.
#[cube]
fn half_angle(v: f32) -> f32 {
    let mut sum = 0.0f32;
    #[unroll]
    for i in 0..comptime!(HALF_ANGLE_F32.len()) {
        let coefficient = comptime!(HALF_ANGLE_F32[i] as f32);
        sum = sum * v + coefficient;
    }
    sum
}
