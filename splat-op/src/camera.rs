//! Cameras: frames and pixel conventions.
//!
//! Axes are OpenCV's: +x right, +y down, +z forward. Pixel centres lie at +0.5, so the first pixel of a row covers
//! `0..1`. Index maps read target-from-source: `mean_cam = cam_from_world * mean_world`.

mod lens;
#[cfg(test)]
mod tests;

use burn::tensor::{Device, Tensor, TensorData};
use glam::DAffine3;

use crate::error::SplatError;

pub use self::lens::Projector;

/// The widest or tallest picture that is accepted, px.
pub const MAX_SIDE_PX: usize = 32_768;

/// The largest coefficient of a lens that is accepted; products of two still fit an f32, and real ones are far below.
pub const MAX_COEFFICIENT: f64 = 1e9;

/// How a point in the camera's frame meets the image plane.
///
/// A model maps the point to a position `d` in units of the focal length, and the picture's is `fx dₓ + cx, fy d_y + cy`. With
/// the slopes `s = (x/z, y/z)` or, for the fisheye models, the angles `s = (x, y) θ/ρ` with `ρ = √(x² + y²)` and
/// `θ = atan2(ρ, z)`, and with `w = |s|²`, it is
///
/// ```text
/// d = s g(w) + 2 (P·s) s + (P + S) w        P = (p2, p1), S = (sx1, sy1)
/// ```
///
/// These are COLMAP's models (`src/colmap/sensor/models.h`), those of OpenCV under other names. A coefficient that a model lacks
/// is zero: with `k2 = p1 = p2 = 0`, `OpenCv` is COLMAP's `SIMPLE_RADIAL`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum CameraModel {
    /// `d = s`: straight lines stay straight.
    #[default]
    Pinhole,
    /// COLMAP's `OPENCV`, and with zeros `SIMPLE_RADIAL` and `RADIAL`: `k1, k2, p1, p2`, `g = 1 + k1 w + k2 w²`.
    OpenCv,
    /// COLMAP's `FULL_OPENCV`: `k1, k2, p1, p2, k3, k4, k5, k6`,
    /// `g = (1 + k1 w + k2 w² + k3 w³) / (1 + k4 w + k5 w² + k6 w³)`.
    FullOpenCv,
    /// Equidistant, COLMAP's `OPENCV_FISHEYE`, and with zeros `FISHEYE`, `SIMPLE_RADIAL_FISHEYE` and `RADIAL_FISHEYE`:
    /// `k1, k2, k3, k4`, `g = 1 + k1 w + k2 w² + k3 w³ + k4 w⁴`.
    Fisheye,
    /// COLMAP's `THIN_PRISM_FISHEYE`: `k1, k2, p1, p2, k3, k4, sx1, sy1`, `g` as for `Fisheye`.
    ThinPrismFisheye,
}

impl CameraModel {
    /// How many of [`Intrinsics::distortion`] it takes.
    pub const fn coefficients(self) -> usize {
        match self {
            Self::Pinhole => 0,
            Self::OpenCv | Self::Fisheye => 4,
            Self::FullOpenCv | Self::ThinPrismFisheye => 8,
        }
    }

    /// Whether it maps angles, not slopes.
    pub const fn is_fisheye(self) -> bool {
        matches!(self, Self::Fisheye | Self::ThinPrismFisheye)
    }
}

/// Size of the picture and the projection onto it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// The projection.
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
    /// The model's coefficients in the order of its documentation, then zeros.
    pub distortion: [f64; 8],
}

impl Intrinsics {
    /// A pinhole camera with square pixels and its principal point in the middle of the picture.
    pub const fn centred(width: usize, height: usize, focal_px: f64) -> Self {
        Self {
            model: CameraModel::Pinhole,
            width,
            height,
            fx: focal_px,
            fy: focal_px,
            cx: width as f64 / 2.0,
            cy: height as f64 / 2.0,
            distortion: [0.0; 8],
        }
    }

    /// The same camera photographing `width` × `height` pixels: focal lengths and principal point scale with each axis.
    /// The coefficients of the lens know no pixels and stay.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (x, y) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { width, height, fx: self.fx * x, fy: self.fy * y, cx: self.cx * x, cy: self.cy * y, ..*self }
    }

    /// Refuses sizes of zero or above [`MAX_SIDE_PX`], focal lengths that are not positive and finite, and coefficients above
    /// [`MAX_COEFFICIENT`] or beyond those of the model.
    pub(crate) fn check(&self) -> Result<(), SplatError> {
        let side = |field, px: usize| match px {
            1..=MAX_SIDE_PX => Ok(()),
            _ => Err(SplatError::Value { field, found: px.to_string(), expected: "1 to 32768 px" }),
        };
        let number = |field, value: f64, ok: bool, expected| match ok {
            true => Ok(()),
            false => Err(SplatError::Value { field, found: value.to_string(), expected }),
        };
        side("width", self.width)?;
        side("height", self.height)?;
        number("fx", self.fx, self.fx > 0.0 && self.fx.is_finite(), "a positive, finite focal length in px")?;
        number("fy", self.fy, self.fy > 0.0 && self.fy.is_finite(), "a positive, finite focal length in px")?;
        number("cx", self.cx, self.cx.is_finite(), "a finite principal point in px")?;
        number("cy", self.cy, self.cy.is_finite(), "a finite principal point in px")?;
        let (used, unused) = self.distortion.split_at(self.model.coefficients());
        for &value in used {
            number("distortion", value, value.abs() <= MAX_COEFFICIENT, "coefficients from -1e9 to 1e9")?;
        }
        for &value in unused {
            number("distortion", value, value == 0.0, "zeros after the coefficients of the camera's model")?;
        }
        Ok(())
    }
}

/// A camera in the world. The pose is a tensor, so that it can be trained.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Size and projection.
    pub intrinsics: Intrinsics,
    /// `[3, 4]`: the rotation and translation that take world coordinates to the camera's.
    pub cam_from_world: Tensor<2>,
}

impl Camera {
    /// A camera at a fixed pose, in the device's default float type.
    pub fn new(intrinsics: Intrinsics, cam_from_world: &DAffine3, device: &Device) -> Self {
        let (m, t) = (cam_from_world.matrix3, cam_from_world.translation);
        let rows: Vec<f64> = (0..3).flat_map(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]).collect();
        Self { intrinsics, cam_from_world: Tensor::from_data(TensorData::new(rows, [3, 4]), device) }
    }
}
