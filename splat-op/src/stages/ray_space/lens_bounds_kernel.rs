//! Bounds in the picture of a lens, in the kernels: the twin is `lens_bounds.rs`.

use core::f32::consts::FRAC_PI_2;

use cubecl::prelude::*;

use super::{EXTENT, LENS_FRAME, RAY_SPACE, ROUNDING};
use crate::camera::{Intrinsics, PictureRays};
use crate::gpu::math::{Mat3, Vec2, Vec2Launch, Vec3, finite};
use crate::project::forward::{PackedEllipse, ProjectCamera};
use crate::project::lens_forward::{Distortion, LensProjection, bent_rows};

/// Columns of a lens in a row.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct LensFrame {
    pub centre: Vec2,
    /// The rows of `G`, px per slope.
    pub x: Vec2,
    pub y: Vec2,
}

/// The Jacobian of a lens at a centre in the camera's frame, for the frame and its gradient.
#[cube]
pub(super) fn jacobian_at(
    mean_cam: Vec3,
    camera: &ProjectCamera,
    distortion: &Distortion,
) -> (Vec3, Vec3, LensProjection) {
    let rows = Mat3 { x: Vec3::new(1.0, 0.0, 0.0), y: Vec3::new(0.0, 1.0, 0.0), z: Vec3::new(0.0, 0.0, 1.0) };
    let (x, y, bent) = bent_rows(mean_cam, rows, Vec3::new(1.0, 1.0, 1.0), &camera.x, &camera.y, distortion);
    (x.j, y.j, bent)
}

#[cube]
impl LensFrame {
    pub fn load(from: &[f32], gaussian: usize) -> LensFrame {
        let at = gaussian * comptime!(RAY_SPACE + LENS_FRAME) + comptime!(RAY_SPACE);
        LensFrame {
            centre: Vec2::new(from[at], from[at + 1]),
            x: Vec2::new(from[at + 2], from[at + 3]),
            y: Vec2::new(from[at + 4], from[at + 5]),
        }
    }

    pub fn store(&self, to: &mut [f32], gaussian: usize, sound: bool) {
        let at = gaussian * comptime!(RAY_SPACE + LENS_FRAME) + comptime!(RAY_SPACE);
        to[at] = select(sound, self.centre.x, 0.0);
        to[at + 1] = select(sound, self.centre.y, 0.0);
        to[at + 2] = select(sound, self.x.x, 0.0);
        to[at + 3] = select(sound, self.x.y, 0.0);
        to[at + 4] = select(sound, self.y.x, 0.0);
        to[at + 5] = select(sound, self.y.y, 0.0);
    }
}

/// What bounds need to know of a lens and its picture; `PictureRays` has the same fields.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct LensLimits {
    low: Vec2,
    high: Vec2,
    farthest: f32,
    bend_px: f32,
    bend_radius: f32,
    stretch_px: f32,
    #[cube(comptime)]
    fisheye: bool,
}

/// The limits of a lens as an argument; `None` for a pinhole.
pub(super) fn lens_limits(camera: &Intrinsics) -> Option<LensLimitsLaunch> {
    let rays = PictureRays::of(camera)?;
    let both = |[x, y]: [f64; 2]| Vec2Launch::new(x as f32, y as f32);
    let held = |value: f64| (value as f32).min(f32::MAX);
    Some(LensLimitsLaunch::new(
        both(rays.low),
        both(rays.high),
        rays.farthest as f32,
        held(rays.bend_px),
        rays.bend_radius as f32,
        held(rays.stretch_px),
        camera.model.is_fisheye(),
    ))
}

/// A row that the lens has bent, whether it is known, and whether it misses the picture.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct BentRow {
    pub row: PackedEllipse,
    pub known: bool,
    pub hidden: bool,
}

#[cube]
fn length(x: f32, y: f32) -> f32 {
    Vec3::new(x, y, 0.0).length()
}

/// Whether the interval around `at` misses that from `low` to `high`. `half` is half its length, `error` that of the middle.
#[cube]
fn misses(centre: f32, middle: f32, half: f32, rounding: f32, low: f32, high: f32) -> bool {
    let slack = (half + middle.abs()) * rounding + half + comptime!(ROUNDING as f32) * centre.abs();
    let at = centre + middle;
    at + slack < low || at - slack > high
}

#[cube]
impl LensLimits {
    pub fn bent(&self, row: &PackedEllipse, e: &PackedEllipse, frame: &LensFrame) -> BentRow {
        let error = comptime!(ROUNDING as f32);
        let extent = comptime!(EXTENT as f32);
        let (a, b, c, d) = (frame.x.x, frame.x.y, frame.y.x, frame.y.y);
        let determinant = a * d - b * c;
        let rounding = error * ((a * d).abs() + (b * c).abs()) / determinant.abs();
        let apart = finite(rounding) && rounding < 1e-2;
        let inverse = 1.0 / determinant;
        let (shift_x, shift_y) = (row.x - e.x, row.y - e.y);
        let (u, x, v) = (extent * row.sigma_u, extent * row.shear * row.sigma_u, extent * row.sigma_v);
        let middle = Vec2::new((d * shift_x - b * shift_y) * inverse, (a * shift_y - c * shift_x) * inverse);
        let along = Vec2::new((d * u - b * x) * inverse, (a * x - c * u) * inverse);
        let across = Vec2::new(-(b * v) * inverse, a * v * inverse);
        let farther = 1.0 + rounding;
        let sides = length(length(along.x, along.y), length(across.x, across.y));
        let reach = (length(middle.x, middle.y) + sides) * farther;
        let (half_x, half_y) = (length(along.x, across.x), length(along.y, across.y));
        let hidden = misses(frame.centre.x, middle.x, half_x, rounding, self.low.x, self.high.x)
            || misses(frame.centre.y, middle.y, half_y, rounding, self.low.y, self.high.y);
        let radius = length(frame.centre.x, frame.centre.y);
        let bend = if comptime!(self.fisheye) {
            let beside = radius > 0.0;
            let axis_x = select(beside, frame.centre.x / select(beside, radius, 1.0), 1.0);
            let axis_y = select(beside, frame.centre.y / select(beside, radius, 1.0), 0.0);
            let axis = Vec2::new(axis_x, axis_y);
            let aside = Vec2::new(-axis_y, axis_x);
            let h_r = (middle.dot(axis).abs() + length(along.dot(axis), across.dot(axis))) * farther;
            let h_t = (middle.dot(aside).abs() + length(along.dot(aside), across.dot(aside))) * farther;
            let near = max(radius - reach, 1e-3);
            let turn = min(h_t / near, 1.0);
            let (h_r, h_t) = (h_r + h_t * turn, h_t + h_r * turn);
            let shrinking = min(FRAC_PI_2 / near, 1.0) * reach;
            let outward_bend = min(2.0 / (near * near * near), 0.65);
            let turning = min(FRAC_PI_2 / (near * near), 0.3);
            let of_angles = 0.5 * (outward_bend * h_r * h_r + turning * h_t * h_t) + turning * h_r * h_t;
            0.5 * self.bend_px * shrinking * shrinking + self.stretch_px * of_angles
        } else {
            let reach = min(reach, radius + self.farthest);
            0.5 * self.bend_px * reach * reach
        };
        let scale = a.abs() + b.abs() + c.abs() + d.abs();
        let by = (bend + error * scale * radius) / extent;
        BentRow {
            row: wider(row, by),
            known: apart && finite(by) && radius <= self.bend_radius,
            hidden: apart && hidden,
        }
    }
}

#[cube]
fn wider(row: &PackedEllipse, by: f32) -> PackedEllipse {
    let (u, x, v) = (row.sigma_u, row.shear * row.sigma_u, row.sigma_v);
    let squares = u * u + x * x + v * v;
    let size = (0.5 * squares).sqrt();
    let (more, extra) = (1.0 + by / size, by * (by + size));
    let square = more * u * u + extra;
    let area = u * v;
    let determinant = more * more * area * area + more * extra * squares + extra * extra;
    PackedEllipse {
        x: row.x,
        y: row.y,
        sigma_u: square.sqrt(),
        shear: more * u * x / square,
        sigma_v: (determinant / square).sqrt(),
        depth: row.depth,
        opacity: row.opacity,
    }
}
