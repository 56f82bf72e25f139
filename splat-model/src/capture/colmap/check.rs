//! Checks shared by both encodings of a model, and how errors name a place in a file.

use std::fmt;
use std::path::{Component, Path};

use glam::{DAffine3, DQuat, DVec3};
use splat_op::Intrinsics;
use splat_op::camera::{MAX_COEFFICIENT, MAX_SIDE_PX};

use super::model::ColmapCameraModel;
use crate::capture::CaptureError;

/// Positions and lens parameters beyond this count as damage. The square of this limit still fits an f32, and no survey needs more.
pub(in crate::capture) const MAX_MAGNITUDE: f64 = 1e15;

const EXPORT_AGAIN: &str = "The file is damaged or the reconstruction failed: export it again, for instance with \
                            `colmap model_converter`";

/// A name as messages quote it: escaped, and truncated to a line.
pub(in crate::capture) fn quoted(name: &str) -> String {
    const MAX_CHARS: usize = 100;
    match name.char_indices().nth(MAX_CHARS) {
        None => format!("{name:?}"),
        Some((cut, _)) => format!("{:?}… of {} bytes", &name[..cut], name.len()),
    }
}

/// The position of an entry in a file, counted from one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum EntryPosition {
    Entry(usize),
    Line(usize),
}

/// An entry of a file, as errors name it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ColmapEntry<'a> {
    pub file: &'a Path,
    /// "camera", "image" or "point".
    pub kind: &'static str,
    pub at: EntryPosition,
}

impl fmt::Display for ColmapEntry<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.at {
            EntryPosition::Entry(index) => write!(out, "{} entry {index}", self.kind),
            EntryPosition::Line(line) => write!(out, "{} on line {line}", self.kind),
        }
    }
}

impl ColmapEntry<'_> {
    /// The error for a field with an invalid value.
    pub fn refuse(&self, field: &'static str, found: impl fmt::Display, expected: impl Into<String>) -> CaptureError {
        self.refuse_with(field, found, expected, EXPORT_AGAIN)
    }

    /// As [`Self::refuse`], where exporting the file again would not help.
    pub fn refuse_with(
        &self,
        field: &'static str,
        found: impl fmt::Display,
        expected: impl Into<String>,
        fix: &'static str,
    ) -> CaptureError {
        let (found, expected) = (found.to_string().into(), expected.into().into());
        CaptureError::Entry { file: self.file.to_owned(), place: self.to_string(), field, found, expected, fix }
    }

    pub fn model_by_number(&self, number: i32) -> Result<ColmapCameraModel, CaptureError> {
        match ColmapCameraModel::name(number) {
            Some(name) => self.model_by_name(name),
            None => self.model_by_name(&format!("number {number}")),
        }
    }

    pub fn model_by_name(&self, name: &str) -> Result<ColmapCameraModel, CaptureError> {
        ColmapCameraModel::by_name(name).ok_or_else(|| self.unsupported(name))
    }

    /// The error for a camera model that cannot be read or written.
    pub fn unsupported(&self, model: &str) -> CaptureError {
        let model = quoted(model).trim_matches('"').to_owned();
        CaptureError::Model { file: self.file.to_owned(), place: self.to_string(), model }
    }

    /// Checks and converts a camera; `parameters` are in the model's order.
    pub fn intrinsics(
        &self,
        model: ColmapCameraModel,
        size_px: [u64; 2],
        parameters: &[f64],
    ) -> Result<Intrinsics, CaptureError> {
        let (focals, rest) = parameters.split_at(model.focals.min(parameters.len()));
        let (fx, fy, cx, cy, coefficients) = match (focals, rest) {
            (&[f], &[cx, cy, ref rest @ ..]) if rest.len() == model.coefficients => (f, f, cx, cy, rest),
            (&[fx, fy], &[cx, cy, ref rest @ ..]) if rest.len() == model.coefficients => (fx, fy, cx, cy, rest),
            _ => {
                let expected = format!("{} numbers", model.parameters());
                return Err(self.refuse("PARAMS", format!("{} numbers", parameters.len()), expected));
            }
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
        let [width, height] = [self.side("WIDTH", size_px[0])?, self.side("HEIGHT", size_px[1])?];
        Ok(Intrinsics { model: model.ours, width, height, fx, fy, cx, cy, distortion })
    }

    fn side(&self, field: &'static str, px: u64) -> Result<usize, CaptureError> {
        match usize::try_from(px) {
            Ok(side @ 1..=MAX_SIDE_PX) => Ok(side),
            _ => Err(self.refuse(field, px, format!("1 to {MAX_SIDE_PX} px"))),
        }
    }

    /// The pose of an image. The quaternion, wxyz, may have any non-zero length.
    pub fn pose(&self, quaternion: [f64; 4], translation: [f64; 3]) -> Result<DAffine3, CaptureError> {
        for (field, value) in ["QW", "QX", "QY", "QZ"].into_iter().zip(quaternion) {
            if !value.is_finite() {
                return Err(self.refuse(field, value, "a finite number"));
            }
        }
        for (field, value) in ["TX", "TY", "TZ"].into_iter().zip(translation) {
            self.check_magnitude(field, value, "a finite number of at most 1e15")?;
        }
        // Dividing by the largest component first keeps the squares from overflowing or underflowing.
        let largest = quaternion.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        if largest == 0.0 {
            return Err(self.refuse("QW QX QY QZ", "0 0 0 0", "a quaternion that is not zero"));
        }
        let [w, x, y, z] = quaternion.map(|value| value / largest);
        let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
        Ok(DAffine3::from_rotation_translation(rotation, DVec3::from_array(translation)))
    }

    pub fn position(&self, xyz: [f64; 3]) -> Result<DVec3, CaptureError> {
        for (field, value) in ["X", "Y", "Z"].into_iter().zip(xyz) {
            self.check_magnitude(field, value, "a finite number of at most 1e15")?;
        }
        Ok(DVec3::from_array(xyz))
    }

    fn check_magnitude(&self, field: &'static str, value: f64, expected: &'static str) -> Result<(), CaptureError> {
        if value.abs() <= MAX_MAGNITUDE { Ok(()) } else { Err(self.refuse(field, value, expected)) }
    }

    /// The name of a picture. It becomes part of a path, so it must stay below the folder of pictures.
    pub fn name(&self, name: &str) -> Result<String, CaptureError> {
        let inside = |part| matches!(part, Component::Normal(_) | Component::CurDir);
        let plain = !name.is_empty() && !name.contains('\0') && Path::new(name).components().all(inside);
        if plain {
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
