//! Cameras: intrinsics, lens models, poses, and the conventions of frames and pixels.
//!
//! Axes are OpenCV's: +x right, +y down, +z forward. Pixel centres lie at +0.5, so the first pixel of a row covers
//! `0..1`. Names of maps read target-from-source: `mean_cam = cam_from_world * mean_world`.

mod lens;
mod rays;
#[cfg(test)]
mod tests;

use burn::tensor::{Device, Tensor, TensorData};
use glam::DAffine3;

use crate::check::check_value;
use crate::error::Result;

pub use self::lens::Projector;
pub(crate) use self::rays::{LEAST_NO_RAY, PictureRays};

/// Largest width or height of a picture that is accepted, px.
pub const MAX_SIDE_PX: usize = 32_768;

/// Largest absolute value of a distortion coefficient that is accepted. Products of two still fit an f32, and coefficients of
/// real lenses are far smaller.
pub const MAX_COEFFICIENT: f64 = 1e9;

/// The projection of a point in the camera's frame onto the image plane.
///
/// A model maps the point to a position `d` in units of the focal length; its pixel position is `fx dₓ + cx, fy d_y + cy`. With
/// the slopes `s = (x/z, y/z)` or, for the fisheye models, the angles `s = (x, y) θ/ρ` with `ρ = √(x² + y²)` and
/// `θ = atan2(ρ, z)`, and with `w = |s|²`, it is
///
/// ```text
/// d = s g(w) + 2 (P·s) s + (P + S) w        P = (p2, p1), S = (sx1, sy1)
/// ```
///
/// The models are COLMAP's (`src/colmap/sensor/models.h`) and, under other names, OpenCV's. A coefficient that a model lacks
/// is zero: with `k2 = p1 = p2 = 0`, `OpenCv` is COLMAP's `SIMPLE_RADIAL`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum CameraModel {
    /// `d = s`: straight lines stay straight.
    #[default]
    Pinhole,
    /// COLMAP's `OPENCV`; with zero coefficients also `SIMPLE_RADIAL` and `RADIAL`: `k1, k2, p1, p2`, `g = 1 + k1 w + k2 w²`.
    OpenCv,
    /// COLMAP's `FULL_OPENCV`: `k1, k2, p1, p2, k3, k4, k5, k6`, `g = (1 + k1 w + k2 w² + k3 w³) / (1 + k4 w + k5 w² + k6 w³)`.
    FullOpenCv,
    /// Equidistant fisheye, COLMAP's `OPENCV_FISHEYE`; with zero coefficients also `FISHEYE`, `SIMPLE_RADIAL_FISHEYE` and `RADIAL_FISHEYE`:
    /// `k1, k2, k3, k4`, `g = 1 + k1 w + k2 w² + k3 w³ + k4 w⁴`.
    Fisheye,
    /// COLMAP's `THIN_PRISM_FISHEYE`: `k1, k2, p1, p2, k3, k4, sx1, sy1`, `g` as for `Fisheye`.
    ThinPrismFisheye,
    /// Parallel rays: `d = s = (x, y)`, so the focal lengths are in px per scene unit. The projection is linear, and a Gaussian's
    /// ellipse is exact. Spherical harmonics see every Gaussian along the camera's axis, the last row of the pose's matrix (gsplat's
    /// `ortho`: from the camera's centre).
    Orthographic,
}

impl CameraModel {
    /// Returns the number of [`Intrinsics::distortion`] coefficients that the model uses.
    pub const fn coefficients(self) -> usize {
        match self {
            Self::Pinhole | Self::Orthographic => 0,
            Self::OpenCv | Self::Fisheye => 4,
            Self::FullOpenCv | Self::ThinPrismFisheye => 8,
        }
    }

    /// Returns whether the model maps angles instead of slopes.
    pub const fn is_fisheye(self) -> bool {
        matches!(self, Self::Fisheye | Self::ThinPrismFisheye)
    }
}

/// Intrinsic parameters of a camera: the size of its picture and the projection onto it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Intrinsics {
    /// Camera model.
    pub model: CameraModel,
    /// Width of the picture, px.
    pub width: usize,
    /// Height of the picture, px.
    pub height: usize,
    /// Focal length along x, px.
    pub fx: f64,
    /// Focal length along y, px.
    pub fy: f64,
    /// Principal point, px from the left border.
    pub cx: f64,
    /// Principal point, px from the upper border.
    pub cy: f64,
    /// Distortion coefficients in the order that [`CameraModel`] documents, then zeros.
    pub distortion: [f64; 8],
}

impl Intrinsics {
    /// Returns a pinhole camera with a picture of `width` × `height` px, the focal lengths along x and y, px, and the principal point, px.
    pub const fn pinhole(width: usize, height: usize, [fx, fy]: [f64; 2], [cx, cy]: [f64; 2]) -> Self {
        Self { model: CameraModel::Pinhole, width, height, fx, fy, cx, cy, distortion: [0.0; 8] }
    }

    /// Returns a pinhole camera with square pixels and its principal point at the centre of the picture. `focal_px` is the focal
    /// length, px.
    pub const fn centred(width: usize, height: usize, focal_px: f64) -> Self {
        Self::pinhole(width, height, [focal_px; 2], [width as f64 / 2.0, height as f64 / 2.0])
    }

    /// Sets the focal lengths, px.
    pub const fn with_focal(self, fx: f64, fy: f64) -> Self {
        Self { fx, fy, ..self }
    }

    /// Sets the principal point, px from the left and the upper border.
    pub const fn with_principal_point(self, cx: f64, cy: f64) -> Self {
        Self { cx, cy, ..self }
    }

    /// Sets the camera model and its coefficients, in the order that [`CameraModel`] documents, then zeros.
    pub const fn with_lens(self, model: CameraModel, distortion: [f64; 8]) -> Self {
        Self { model, distortion, ..self }
    }

    /// Returns the intrinsics of the same camera for a picture of `width` × `height` px. Focal lengths and principal point scale
    /// with each axis. Distortion coefficients do not depend on the pixel size and stay.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (x, y) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { width, height, fx: self.fx * x, fy: self.fy * y, cx: self.cx * x, cy: self.cy * y, ..*self }
    }

    /// Refuses sizes of zero or above [`MAX_SIDE_PX`], focal lengths that are not positive and finite, coefficients above
    /// [`MAX_COEFFICIENT`], and non-zero coefficients that the model does not use.
    pub(crate) fn check(&self) -> Result<()> {
        let side = |field, px| check_value(field, (1..=MAX_SIDE_PX).contains(&px), px, "1 to 32768 px");
        side("width", self.width)?;
        side("height", self.height)?;
        check_value("fx", self.fx > 0.0 && self.fx.is_finite(), self.fx, "a positive, finite focal length in px")?;
        check_value("fy", self.fy > 0.0 && self.fy.is_finite(), self.fy, "a positive, finite focal length in px")?;
        check_value("cx", self.cx.is_finite(), self.cx, "a finite principal point in px")?;
        check_value("cy", self.cy.is_finite(), self.cy, "a finite principal point in px")?;
        let (used, unused) = self.distortion.split_at(self.model.coefficients());
        for &value in used {
            check_value("distortion", value.abs() <= MAX_COEFFICIENT, value, "coefficients from -1e9 to 1e9")?;
        }
        for &value in unused {
            check_value("distortion", value == 0.0, value, "zeros after the coefficients of the camera's model")?;
        }
        Ok(())
    }
}

/// A camera in the world: intrinsics and pose. The pose is a tensor, so that it can be optimised.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Size of the picture and projection.
    pub intrinsics: Intrinsics,
    /// `[3, 4]`: rotation and translation from the world frame to the camera's frame, `mean_cam = R * mean_world + t`; the
    /// translation is in scene units.
    pub cam_from_world: Tensor<2>,
}

impl Camera {
    /// Creates a camera at a fixed pose, with a tensor of the device's default float type.
    pub fn new(intrinsics: Intrinsics, cam_from_world: &DAffine3, device: &Device) -> Self {
        let (m, t) = (cam_from_world.matrix3, cam_from_world.translation);
        let rows: Vec<f64> = (0..3).flat_map(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]).collect();
        Self { intrinsics, cam_from_world: Tensor::from_data(TensorData::new(rows, [3, 4]), device) }
    }
}
