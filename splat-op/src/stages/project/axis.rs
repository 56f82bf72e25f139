//! One axis of the picture in the kernels of `project`.

use cubecl::prelude::*;

use crate::gpu::{Vec3, within};

/// One axis of the picture, px.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct CameraAxis {
    pub focal: f32,
    pub principal: f32,
    /// Limits to which `x/z` or `y/z` is clamped for the Jacobian.
    pub low: f32,
    pub high: f32,
}

#[cube]
impl CameraAxis {
    /// `across` is the camera x or y of the centre; `row` and `last` are rows of `W R`.
    pub fn project(&self, across: f32, depth: f32, row: Vec3, last: Vec3, scale: Vec3) -> JacobianRow {
        let ratio = across / depth;
        let slope = within(ratio, self.low, self.high);
        let j = row.minus(last.times(slope)).times(self.focal / depth);
        JacobianRow { ratio, slope, slope_free: slope == ratio, j, m: j.by_axis(scale) }
    }
}

/// Projection of a Gaussian along one axis of the picture.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct JacobianRow {
    /// `x/z` or `y/z`, the slope at which the Jacobian is evaluated, and whether that slope is free (not clamped). With a lens,
    /// `ratio` is the distorted position of the centre in units of the focal length, and nothing reads the slope.
    pub ratio: f32,
    pub slope: f32,
    pub slope_free: bool,
    /// Row of `J W R`, and that row times the scales.
    pub j: Vec3,
    pub m: Vec3,
}
