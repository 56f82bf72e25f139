//! Cameras: frames and pixel conventions.
//!
//! Axes are OpenCV's: +x right, +y down, +z forward. Pixel centres lie at +0.5, so the first pixel of a row covers
//! `0..1`. Index maps read target-from-source: `mean_cam = cam_from_world * mean_world`.

use burn::tensor::{Device, Tensor, TensorData};
use glam::DAffine3;

use crate::error::SplatError;

/// The widest or tallest picture that is accepted, px.
pub const MAX_SIDE_PX: usize = 32_768;

/// How a point in the camera's frame meets the image plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum CameraModel {
    /// `u = fx x/z + cx`, `v = fy y/z + cy`.
    #[default]
    Pinhole,
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
}

impl Intrinsics {
    /// A pinhole camera with square pixels and its principal point in the middle of the picture.
    pub fn centred(width: usize, height: usize, focal_px: f64) -> Self {
        Self {
            model: CameraModel::Pinhole,
            width,
            height,
            fx: focal_px,
            fy: focal_px,
            cx: width as f64 / 2.0,
            cy: height as f64 / 2.0,
        }
    }

    /// The same camera photographing `width` × `height` pixels: focal lengths and principal point scale with each axis.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (x, y) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { width, height, fx: self.fx * x, fy: self.fy * y, cx: self.cx * x, cy: self.cy * y, ..*self }
    }

    /// Refuses sizes of zero or above [`MAX_SIDE_PX`], and focal lengths that are not positive and finite.
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
        number("cy", self.cy, self.cy.is_finite(), "a finite principal point in px")
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
