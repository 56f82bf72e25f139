//! Per-ray rasterization in its direct form: covariances in the camera's frame, inverted.

use glam::{DMat2, DMat3, DVec3};

/// A Gaussian in the camera's frame or in coordinates that are a linear map of that frame.
pub(super) struct Solid {
    /// Centre relative to the camera's centre.
    centre: DVec3,
    /// Inverse of the covariance.
    precision: DMat3,
    /// The map of [`Solid::on_screen`] with the translation that takes the direction to the centre to `(0, 0, 1)`.
    on_screen: DMat3,
}

/// A ray in the camera's frame.
#[derive(Clone, Copy)]
pub(super) struct Ray {
    pub origin: DVec3,
    pub direction: DVec3,
}

/// Maximum of a Gaussian along a ray.
pub(super) struct Met {
    /// Position of the maximum along the ray, in lengths of the ray's direction.
    pub at: f64,
    /// Value at the maximum, relative to the value at the centre.
    pub value: f64,
}

impl Solid {
    /// Gaussian in the camera's frame, widened across the plane of the centre's depth by as much as the projection with the Jacobian
    /// `[j0, j1]` maps to `blur`, px².
    pub fn in_camera(centre: DVec3, covariance: DMat3, [j0, j1]: [DVec3; 2], blur: f64) -> Self {
        let from_px = DMat2::from_cols(j0.truncate(), j1.truncate()).transpose().inverse();
        let wide = blur * from_px * from_px.transpose();
        let blur = DMat3::from_cols(wide.x_axis.extend(0.0), wide.y_axis.extend(0.0), DVec3::ZERO);
        Self { centre, precision: (covariance + blur).inverse(), on_screen: DMat3::IDENTITY }
    }

    /// Gaussian in px across the picture, by the projection's Jacobian `[j0, j1]`, and in units of the centre's depth along z.
    pub fn on_screen(centre: DVec3, covariance: DMat3, [j0, j1]: [DVec3; 2], blur: f64) -> Self {
        let map = DMat3::from_cols(j0, j1, DVec3::Z / centre.z).transpose();
        let blur = DMat3::from_diagonal(DVec3::new(blur, blur, 0.0));
        let precision = (map * covariance * map.transpose() + blur).inverse();
        // A clamped Jacobian does not map the centre to the origin of the pixels.
        let off = map * centre - DVec3::Z;
        let on_screen = map - DMat3::from_cols(DVec3::ZERO, DVec3::ZERO, off / centre.z);
        Self { centre: DVec3::Z, precision, on_screen }
    }

    /// The ray in the coordinates of the Gaussian.
    pub fn on_screen_ray(&self, ray: Ray) -> Ray {
        Ray { direction: self.on_screen * ray.direction, ..ray }
    }

    pub fn meet(&self, Ray { origin, direction }: Ray) -> Met {
        let towards = self.precision * direction;
        let at = towards.dot(self.centre - origin) / towards.dot(direction);
        let offset = origin + at * direction - self.centre;
        Met { at, value: (-0.5 * offset.dot(self.precision * offset)).exp() }
    }
}
