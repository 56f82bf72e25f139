//! Kernel of `evaluate_sh`, forward: one unit per Gaussian. The backward kernel shares the camera's position, the direction from it
//! and the spherical harmonics. Their degree is a compile-time constant of a kernel.

use cubecl::prelude::*;

use super::{SH_COEFFICIENTS_MAX, coefficients_of, vector_width};
use crate::gpu::{Mat3, Pose, Vec3, negative, positive};
use crate::project::forward::PackedEllipse;

/// Position of the camera in the world frame: the point that the pose maps to zero, `−A⁻¹ t`, by the general inverse.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct CameraPosition {
    /// `A⁻¹`.
    pub world_from_cam: Mat3,
    pub position: Vec3,
}

#[cube]
impl CameraPosition {
    pub fn of(pose: Pose) -> CameraPosition {
        let a = pose.matrix;
        let cofactors = Mat3 { x: a.y.cross(a.z), y: a.z.cross(a.x), z: a.x.cross(a.y) };
        let inverse = 1.0 / a.x.dot(cofactors.x);
        let scaled =
            Mat3 { x: cofactors.x.times(inverse), y: cofactors.y.times(inverse), z: cofactors.z.times(inverse) };
        let world_from_cam = scaled.transposed();
        CameraPosition { world_from_cam, position: world_from_cam.apply(pose.translation).times(-1.0) }
    }

    /// Direction to a centre; +z for a centre at the camera's position.
    pub fn view_direction(&self, mean: Vec3) -> ViewDirection {
        let to_mean = mean.minus(self.position);
        let distance = to_mean.length();
        let inverse = 1.0 / distance;
        let apart = positive(distance);
        let direction = Vec3::new(
            select(apart, to_mean.x * inverse, 0.0),
            select(apart, to_mean.y * inverse, 0.0),
            select(apart, to_mean.z * inverse, 1.0),
        );
        ViewDirection { direction, distance }
    }
}

/// Unit direction from the camera to a centre, and the distance, scene units.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct ViewDirection {
    pub direction: Vec3,
    pub distance: f32,
}

/// Factors of the polynomials below, with the signs of the original code.
pub(super) const NORMS: [f32; SH_COEFFICIENTS_MAX] = [
    0.282_094_79,
    -0.488_602_51,
    0.488_602_51,
    -0.488_602_51,
    1.092_548_4,
    -1.092_548_4,
    0.315_391_57,
    -1.092_548_4,
    0.546_274_2,
    -0.590_043_6,
    2.890_611_4,
    -0.457_045_8,
    0.373_176_33,
    -0.457_045_8,
    1.445_305_7,
    -0.590_043_6,
    2.503_342_9,
    -1.770_130_8,
    0.946_174_7,
    -0.669_046_5,
    0.105_785_55,
    -0.669_046_5,
    0.473_087_35,
    -1.770_130_8,
    0.625_835_7,
];

/// `Yₖ(d)` for every `k < (degree+1)²`.
#[cube]
pub(crate) fn basis(d: Vec3, #[comptime] degree: usize) -> Sequence<f32> {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let mut p = Sequence::<f32>::new();
    p.push(1.0f32.runtime());
    if comptime!(degree >= 1) {
        p.push(y);
        p.push(z);
        p.push(x);
    }
    if comptime!(degree >= 2) {
        p.push(x * y);
        p.push(y * z);
        p.push(2.0 * zz - xx - yy);
        p.push(x * z);
        p.push(xx - yy);
    }
    if comptime!(degree >= 3) {
        let four = 4.0 * zz - xx - yy;
        p.push(y * (3.0 * xx - yy));
        p.push(x * y * z);
        p.push(y * four);
        p.push(z * (2.0 * zz - 3.0 * (xx + yy)));
        p.push(x * four);
        p.push(z * (xx - yy));
        p.push(x * (xx - 3.0 * yy));
    }
    if comptime!(degree >= 4) {
        let (one, three) = (7.0 * zz - 1.0, 7.0 * zz - 3.0);
        p.push(x * y * (xx - yy));
        p.push(y * z * (3.0 * xx - yy));
        p.push(x * y * one);
        p.push(y * z * three);
        p.push(zz * (35.0 * zz - 30.0) + 3.0);
        p.push(x * z * three);
        p.push((xx - yy) * one);
        p.push(x * z * (xx - 3.0 * yy));
        p.push(xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy));
    }
    let mut out = Sequence::<f32>::new();
    #[unroll]
    for k in 0..comptime!(coefficients_of(degree)) {
        out.push(p[k] * comptime!(NORMS[k]));
    }
    out
}

/// Coefficients of a Gaussian, in registers: three channels of each.
#[cube]
pub(super) fn load_row<W: Size>(sh: &[Vector<f32, W>], gaussian: usize, #[comptime] degree: usize) -> Sequence<f32> {
    let mut row = Sequence::<f32>::new();
    let width = comptime!(vector_width(degree));
    let vectors = comptime!(3 * coefficients_of(degree) / width);
    #[unroll]
    for at in 0..vectors {
        let numbers = sh[gaussian * vectors + at];
        #[unroll]
        for i in 0..width {
            row.push(numbers.extract(i));
        }
    }
    row
}

/// Coefficient `k` of a row, one number per channel.
#[cube]
pub(super) fn coefficient(row: &Sequence<f32>, #[comptime] k: usize) -> Vec3 {
    Vec3::new(row[comptime!(3 * k)], row[comptime!(3 * k + 1)], row[comptime!(3 * k + 2)])
}

/// Colour before the clamp.
#[cube]
pub(super) fn linear_colour(row: &Sequence<f32>, basis: &Sequence<f32>, #[comptime] degree: usize) -> Vec3 {
    let mut colour = Vec3::new(0.5, 0.5, 0.5);
    #[unroll]
    for k in 0..comptime!(coefficients_of(degree)) {
        colour = colour.plus(coefficient(row, k).times(basis[k]));
    }
    colour
}

/// The picture, for the test of visibility.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Frame {
    /// Extent of a Gaussian with an opacity of 1, in standard deviations.
    pub sigmas: f32,
    /// Width, px.
    pub width: f32,
    /// Height, px.
    pub height: f32,
}

/// Whether a Gaussian can show in the picture, by its packed ellipse; see [`super`].
#[cube]
pub(super) fn may_show(ellipses: &[f32], gaussian: usize, frame: &Frame) -> bool {
    let ellipse = PackedEllipse::load(ellipses, gaussian);
    let half_x = frame.sigmas * ellipse.sigma_u + 1.0;
    let half_y = frame.sigmas * (ellipse.sigma_v + ellipse.shear.abs() * ellipse.sigma_u) + 1.0;
    let beside = ellipse.x + half_x >= 0.0 && ellipse.x - half_x <= frame.width;
    let level = ellipse.y + half_y >= 0.0 && ellipse.y - half_y <= frame.height;
    ellipse.opacity > 1.0 || (ellipse.opacity > 0.0 && beside && level)
}

/// Colour of a Gaussian.
#[cube]
fn colour_of<W: Size>(
    sh: &[Vector<f32, W>],
    gaussian: usize,
    mean: Vec3,
    pose: Pose,
    #[comptime] degree: usize,
) -> Vec3 {
    let row = load_row(sh, gaussian, degree);
    let view_direction = CameraPosition::of(pose).view_direction(mean);
    let colour = linear_colour(&row, &basis(view_direction.direction, degree), degree);
    // Neither `max` nor a comparison, which may turn NaN into a colour.
    Vec3::new(
        select(negative(colour.x), 0.0, colour.x),
        select(negative(colour.y), 0.0, colour.y),
        select(negative(colour.z), 0.0, colour.z),
    )
}

#[cube(launch_unchecked)]
pub(super) fn sh_forward_kernel<W: Size>(
    sh: &[Vector<f32, W>],
    means: &[f32],
    cam_from_world: &[f32],
    ellipses: ComptimeOption<Box<[f32]>>,
    colours: &mut [f32],
    frame: Frame,
    count: u32,
    #[comptime] degree: usize,
) {
    if ABSOLUTE_POS < count as usize {
        let mut visible = true;
        #[comptime]
        if let ComptimeOption::Some(ellipses) = ellipses {
            visible = may_show(&ellipses, ABSOLUTE_POS, &frame);
        }
        let mut colour = Vec3::new(0.0, 0.0, 0.0);
        if visible {
            let mean = Vec3::load(means, 3 * ABSOLUTE_POS);
            colour = colour_of(sh, ABSOLUTE_POS, mean, Pose::load(cam_from_world), degree);
        }
        colour.store(colours, 3 * ABSOLUTE_POS);
    }
}
