//! Checks shared by both encodings of a model.

use glam::{DAffine3, DQuat, DVec3};
use splat_op::Intrinsics;
use splat_op::camera::{MAX_COEFFICIENT, MAX_SIDE_PX};

use super::model::ColmapCameraModel;
use crate::capture::names::below;
use crate::capture::read::{MAX_MAGNITUDE, Place, quoted};
use crate::capture::{CaptureError, Cut, Result};

impl Place<'_> {
    pub(super) fn model_by_name(&self, name: &str) -> Result<ColmapCameraModel> {
        ColmapCameraModel::by_name(name).ok_or_else(|| self.unsupported(name))
    }

    /// The error for a camera model that cannot be read or written.
    pub(super) fn unsupported(&self, model: &str) -> CaptureError {
        let detail = format!(
            "{self}: the camera model is {}, which is not supported, while the pinhole, radial, OPENCV and fisheye models are. Remove the lens \
             distortion with `colmap image_undistorter` and use the folder that it writes, or reconstruct with another \
             `--ImageReader.camera_model`",
            quoted(model).trim_matches('"')
        );
        CaptureError::content(self.file, detail)
    }

    /// Checks and converts a camera; `parameters` are in the model's order.
    pub(super) fn intrinsics(
        &self,
        model: ColmapCameraModel,
        size_px: [u64; 2],
        parameters: &[f64],
    ) -> Result<(Intrinsics, Cut)> {
        let [width, height] = [self.side("WIDTH", size_px[0])?, self.side("HEIGHT", size_px[1])?];
        let (focals, rest) = parameters.split_at(model.focals.min(parameters.len()));
        let (fx, fy, cx, cy, coefficients) = match (focals, rest) {
            (&[], &[w, h]) => {
                let refuse =
                    || self.refuse("PARAMS", format!("{w} {h}"), format!("{width} {height}, WIDTH and HEIGHT"));
                let panorama = (Intrinsics::centred(width, height, 1.0), Cut::Panorama);
                return ([w, h] == [width as f64, height as f64]).then_some(panorama).ok_or_else(refuse);
            }
            (&[f], &[cx, cy, ref rest @ ..]) if rest.len() == model.coefficients => (f, f, cx, cy, rest),
            (&[fx, fy], &[cx, cy, ref rest @ ..]) if rest.len() == model.coefficients => (fx, fy, cx, cy, rest),
            _ => return Err(self.parameters(model, parameters.len())),
        };
        for focal in [fx, fy] {
            if !(focal > 0.0 && focal <= MAX_MAGNITUDE) {
                return Err(self.refuse("PARAMS", focal, "a positive, finite focal length in px"));
            }
        }
        for centre in [cx, cy] {
            self.check_magnitude("PARAMS", centre, "a finite principal point in px")?;
        }
        let mut distortion = [0.0; 8];
        for (kept, &coefficient) in distortion.iter_mut().zip(coefficients) {
            if !(coefficient.abs() <= MAX_COEFFICIENT) {
                return Err(self.refuse("PARAMS", coefficient, "a coefficient of the lens from -1e9 to 1e9"));
            }
            *kept = coefficient;
        }
        let intrinsics = Intrinsics::pinhole(width, height, [fx, fy], [cx, cy]).with_lens(model.ours, distortion);
        Ok((intrinsics, Cut::Whole))
    }

    /// The error for a camera with so many parameters.
    pub(super) fn parameters(&self, model: ColmapCameraModel, found: usize) -> CaptureError {
        let expected = format!("{} numbers for the camera model {}", model.parameters(), model.own_name());
        self.refuse("PARAMS", format!("{found} numbers"), expected)
    }

    fn side(&self, field: &'static str, px: u64) -> Result<usize> {
        match usize::try_from(px) {
            Ok(side @ 1..=MAX_SIDE_PX) => Ok(side),
            _ => Err(self.refuse(field, px, format!("1 to {MAX_SIDE_PX} px"))),
        }
    }

    /// The pose of an image. The quaternion, wxyz, may have any non-zero length.
    pub(in crate::capture) fn pose(&self, quaternion: [f64; 4], translation: [f64; 3]) -> Result<DAffine3> {
        for (field, value) in ["QW", "QX", "QY", "QZ"].into_iter().zip(quaternion) {
            if !value.is_finite() {
                return Err(self.refuse(field, value, "a finite number"));
            }
        }
        let translation = self.vector(["TX", "TY", "TZ"], translation)?;
        // Dividing by the largest component first keeps the squares from overflowing or underflowing.
        let largest = quaternion.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        if largest == 0.0 {
            return Err(self.refuse("QW QX QY QZ", "0 0 0 0", "a quaternion that is not zero"));
        }
        let [w, x, y, z] = quaternion.map(|value| value / largest);
        let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
        Ok(DAffine3::from_rotation_translation(rotation, translation))
    }

    /// A position or translation.
    pub(super) fn vector(&self, fields: [&'static str; 3], xyz: [f64; 3]) -> Result<DVec3> {
        for (field, value) in fields.into_iter().zip(xyz) {
            self.check_magnitude(field, value, "a finite number of at most 1e15")?;
        }
        Ok(DVec3::from_array(xyz))
    }

    fn check_magnitude(&self, field: &'static str, value: f64, expected: &'static str) -> Result<()> {
        if value.abs() <= MAX_MAGNITUDE { Ok(()) } else { Err(self.refuse(field, value, expected)) }
    }

    /// The name of a picture. It becomes part of a path, so it must stay below the folder of pictures.
    pub(super) fn name(&self, name: &str) -> Result<String> {
        if below(name).is_some() && !name.contains('\0') {
            return Ok(name.to_owned());
        }
        Err(self.refuse_with(
            "NAME",
            quoted(name),
            "a path below `images/`, neither absolute nor with `..`",
            "Reconstruct with the folder of pictures as COLMAP's `--image_path`, so that names are relative to it",
        ))
    }
}
