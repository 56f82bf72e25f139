//! Real scale: how many metres a scene unit is, from the GPS of EXIF or from a file.
//!
//! A reconstruction from photographs knows no size. [`Scale`] is kept beside it in `scale.json`, and
//! [`Capture::load`](super::Capture::load) reads it.

mod gps;

use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use gps::from_gps;

use super::read::read;
use super::{CaptureError, Result};
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

/// A scale that cannot be determined: what was found, and what helps.
#[derive(Debug, Error)]
#[error("{0}, or measure a distance and write {{\"metres_per_unit\": M}} to scale.json in the capture's folder")]
pub struct ScaleError(String);

impl Scale {
    /// Reads `scale.json` in a capture's folder, `None` if there is none.
    ///
    /// # Errors
    /// A [`CaptureError`] if the file cannot be read or does not hold a positive number of metres.
    pub fn load(folder: &Path) -> Result<Option<Self>> {
        let file = folder.join(SCALE_FILE);
        if !file.exists() {
            return Ok(None);
        }
        let damaged = |found: String| {
            let expected = "{\"metres_per_unit\": M} with a positive number";
            let detail =
                format!("{found}, expected {expected}; correct the file, or remove it and give the scale again");
            CaptureError::content(&file, detail)
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
    pub fn save(&self, folder: &Path) -> Result<()> {
        let file = folder.join(SCALE_FILE);
        let text = serde_json::to_string_pretty(self).expect("numbers and text are JSON");
        replace(&file, |out| writeln!(out, "{text}")).map_err(|reason| CaptureError::unwritable(&file, &reason))
    }
}

/// Whether a number can be metres per scene unit.
pub(crate) fn is_scale(metres_per_unit: f64) -> bool {
    metres_per_unit.is_finite() && metres_per_unit > 0.0
}

#[cfg(test)]
mod tests;
