//! Real scale: how many metres a scene unit is, from two marked points with a known distance or from the GPS of EXIF.
//!
//! A reconstruction from photographs knows no size. [`Scale`] is kept beside it in `scale.json`, and
//! [`Capture::load`](super::Capture::load) reads it.

mod gps;
mod marks;

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use gps::from_gps;
pub use marks::{Mark, from_marks, in_stored_pictures, parse_marks};

use super::CaptureError;
use super::read::read;
use crate::replace::replace;

/// The file beside a reconstruction that holds its scale.
pub const SCALE_FILE: &str = "scale.json";

/// The size of a scene unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// Metres per scene unit: finite and positive.
    pub metres_per_unit: f64,
    /// Standard deviation of that, as a fraction of it, where it can be estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_deviation: Option<f64>,
    /// What it was measured from, in words.
    #[serde(default)]
    pub source: String,
}

/// A scale that cannot be determined. Each message says what was found and what helps.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ScaleError {
    /// A line of a file of marks is not one.
    #[error("{}: line {line} is `{found}`, expected `NAME PHOTOGRAPH X Y` with the position in px", .file.display())]
    Line {
        /// The file of marks.
        file: PathBuf,
        /// The line, from one.
        line: usize,
        /// The line's text.
        found: String,
    },
    /// A point is not marked in two photographs whose cameras are known.
    #[error(
        "the point `{name}` is marked in {placed} photographs with known cameras{}, expected at least two that show it from \
         different sides: mark it in more photographs", without_camera(.unplaced)
    )]
    TooFewMarks {
        /// The point.
        name: String,
        /// The number of photographs with known cameras that show it.
        placed: usize,
        /// Photographs whose camera is unknown.
        unplaced: Vec<String>,
    },
    /// Two photographs with marks look at a point from the same direction.
    #[error(
        "the photographs in which the point `{name}` is marked see it from directions {angle_deg:.2}° apart, expected at least \
         {expected_deg}°: mark it in photographs taken further apart"
    )]
    Parallel {
        /// The point.
        name: String,
        /// The largest angle between two rays, degrees.
        angle_deg: f64,
        /// The smallest that is accepted, degrees.
        expected_deg: f64,
    },
    /// The marks of a point do not meet.
    #[error(
        "the marks of the point `{name}` do not meet: in {photograph} it is {error_px:.0} px from where the other photographs \
         place it, expected at most {expected_px:.0} px: mark the same point in each photograph, x to the right and y down from \
         the upper left corner"
    )]
    Disagree {
        /// The point.
        name: String,
        /// The photograph with the largest error.
        photograph: String,
        /// The error, px.
        error_px: f64,
        /// The largest error that is accepted, px.
        expected_px: f64,
    },
    /// Two marked points are at the same place.
    #[error("the points `{0}` and `{1}` are at the same place: mark two points that are far apart")]
    Coincide(String, String),
    /// A distance that no two points have.
    #[error("the distance is {0}, expected a positive number of metres")]
    Distance(f64),
    /// Too few photographs with a known camera have GPS.
    #[error(
        "{found} of {placed} placed photographs have a GPS position in EXIF, expected at least {expected}: switch on the \
         location in the camera, or measure a distance and give two marked points"
    )]
    TooFewPositions {
        /// Photographs with both.
        found: usize,
        /// Photographs with a camera.
        placed: usize,
        /// The least that is accepted.
        expected: usize,
    },
    /// The GPS positions do not determine the scale.
    #[error(
        "the GPS positions of {photographs} photographs determine the scale to ±{percent:.0}%, expected ±{expected_percent:.0}% \
         or better: they differ by {residual_m:.1} m from the cameras, which are {spread_m:.1} m from their mean; cover more ground, \
         or measure a distance and give two marked points"
    )]
    Noise {
        /// Photographs with GPS and a camera.
        photographs: usize,
        /// Standard deviation of the scale, %.
        percent: f64,
        /// The largest that is accepted, %.
        expected_percent: f64,
        /// Root mean square distance between positions and cameras, m.
        residual_m: f64,
        /// Root mean square distance of the cameras from their mean, m.
        spread_m: f64,
    },
}

fn without_camera(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [first] => format!(" ({first} is not one)"),
        [first, rest @ ..] => format!(" ({first} and {} others are not)", rest.len()),
    }
}

impl Scale {
    /// Reads `scale.json` in a capture's folder, `None` if there is none.
    ///
    /// # Errors
    /// A [`CaptureError`] if the file cannot be read or does not hold a positive number of metres.
    pub fn load(folder: &Path) -> Result<Option<Self>, CaptureError> {
        let file = folder.join(SCALE_FILE);
        if !file.exists() {
            return Ok(None);
        }
        let damaged = |found: String| CaptureError::Damaged {
            file: file.clone(),
            detail: format!(
                "{found}, expected {{\"metres_per_unit\": M}} with a positive number; correct the file, or remove it and give \
                 the scale again"
            ),
        };
        let scale: Self = serde_json::from_slice(&read(&file)?).map_err(|error| damaged(error.to_string()))?;
        match is_scale(scale.metres_per_unit) {
            true => Ok(Some(scale)),
            false => Err(damaged(format!("`metres_per_unit` is {}", scale.metres_per_unit))),
        }
    }

    /// Writes `scale.json` into a capture's folder.
    ///
    /// # Errors
    /// A [`CaptureError`] if the file cannot be written.
    pub fn save(&self, folder: &Path) -> Result<(), CaptureError> {
        let file = folder.join(SCALE_FILE);
        let text = serde_json::to_string_pretty(self).expect("numbers and text are JSON");
        replace(&file, |out| writeln!(out, "{text}"))
            .map_err(|refused| CaptureError::Write { file, reason: refused.source })
    }
}

/// Whether a number can be metres per scene unit.
pub(crate) fn is_scale(metres_per_unit: f64) -> bool {
    metres_per_unit.is_finite() && metres_per_unit > 0.0
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::super::testing::assert_says;
    use super::*;

    #[test]
    fn a_scale_is_kept_beside_the_capture() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Scale::load(folder.path()).unwrap(), None);
        let scale = Scale { metres_per_unit: 0.1 + 0.2, relative_deviation: None, source: "a ruler".into() };
        scale.save(folder.path()).unwrap();
        assert_eq!(Scale::load(folder.path()).unwrap(), Some(scale));
        for (text, found) in
            [("{\"metres_per_unit\": -1}", "is -1"), ("{}", "missing field"), ("{\"metres_per_unit\": 1e999}", "range")]
        {
            fs::write(folder.path().join(SCALE_FILE), text).unwrap();
            assert_says(&Scale::load(folder.path()).unwrap_err().to_string(), &[SCALE_FILE, found, "correct the file"]);
        }
    }
}
