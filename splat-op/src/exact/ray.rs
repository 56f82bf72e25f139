//! Per-ray rasterization in its direct form: covariances in the camera's frame, inverted.

use glam::{DMat3, DVec2, DVec3};

use crate::camera::Intrinsics;

/// A Gaussian in the camera's frame or in coordinates that are a linear map of that frame.
pub(super) struct Solid {
    /// Centre relative to the origin of the rays.
    centre: DVec3,
    /// Inverse of the covariance.
    precision: DMat3,
}

/// Maximum of a Gaussian along a ray.
pub(super) struct Met {
    /// Position of the maximum along the ray, in lengths of the ray's direction.
    pub at: f64,
    /// Value at the maximum, relative to the value at the centre.
    pub value: f64,
}

impl Solid {
    /// Gaussian in the camera's frame, widened by `blur`, px² on the picture, at the centre's depth.
    pub fn in_camera(centre: DVec3, covariance: DMat3, camera: &Intrinsics, blur: f64) -> Self {
        let px = DVec3::new(centre.z / camera.fx, centre.z / camera.fy, 0.0);
        Self { centre, precision: (covariance + DMat3::from_diagonal(blur * px * px)).inverse() }
    }

    /// Gaussian in px across the picture, by the projection's Jacobian `[j0, j1]`, and in units of the centre's depth along z.
    pub fn on_screen(centre: DVec3, covariance: DMat3, [j0, j1]: [DVec3; 2], blur: f64) -> Self {
        let map = DMat3::from_cols(j0, j1, DVec3::Z / centre.z).transpose();
        let blur = DMat3::from_diagonal(DVec3::new(blur, blur, 0.0));
        Self { centre: DVec3::Z, precision: (map * covariance * map.transpose() + blur).inverse() }
    }

    pub fn meet(&self, direction: DVec3) -> Met {
        let towards = self.precision * direction;
        let at = towards.dot(self.centre) / towards.dot(direction);
        let offset = at * direction - self.centre;
        Met { at, value: (-0.5 * offset.dot(self.precision * offset)).exp() }
    }
}

/// Direction of a pinhole camera's ray through a position, px, with z one.
pub(super) fn direction(camera: &Intrinsics, pixel: DVec2) -> DVec3 {
    DVec3::new((pixel.x - camera.cx) / camera.fx, (pixel.y - camera.cy) / camera.fy, 1.0)
}
