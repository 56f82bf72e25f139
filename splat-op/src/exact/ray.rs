//! Pixels that look along their rays, as one would write it down: covariances in the camera's frame, inverted.

use glam::{DMat3, DVec2, DVec3};

use crate::camera::Intrinsics;

/// A Gaussian in space, or in coordinates that are a linear map of it.
pub(super) struct Solid {
    /// From the point that rays start at to the centre.
    centre: DVec3,
    /// The inverse of its covariance.
    precision: DMat3,
}

/// What a ray meets.
pub(super) struct Met {
    /// Where on the ray the Gaussian is greatest, in lengths of its direction.
    pub at: f64,
    /// The Gaussian there, by its value at the centre.
    pub value: f64,
}

impl Solid {
    /// In the camera's frame, and wider by what `blur` px² across the picture are at the centre's depth.
    pub fn in_camera(centre: DVec3, covariance: DMat3, camera: &Intrinsics, blur: f64) -> Self {
        let px = DVec3::new(centre.z / camera.fx, centre.z / camera.fy, 0.0);
        Self { centre, precision: (covariance + DMat3::from_diagonal(blur * px * px)).inverse() }
    }

    /// In px across the picture, by the projection's Jacobian `[j0, j1]`, and depths in units of the centre's.
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

/// The direction in which a pinhole's pixel looks, with z one.
pub(super) fn direction(camera: &Intrinsics, pixel: DVec2) -> DVec3 {
    DVec3::new((pixel.x - camera.cx) / camera.fx, (pixel.y - camera.cy) / camera.fy, 1.0)
}
