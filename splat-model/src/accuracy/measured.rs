//! Measurements of settings on a scene and a device, as stored in `pareto.json`.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::frontier::Spread;
use super::provenance::Provenance;
use super::setting::Setting;
use crate::json;

/// Name of the setting that changes no dial.
pub const STANDARD: &str = "standard";

/// Smallest error that is reported. It is below the precision of f32, and JSON has no infinity.
const SMALLEST_RMS: f64 = 1e-15;

/// Converts a root mean square error relative to 1 into dB: higher is better, at most 300. NaN stays NaN.
pub fn decibels(rms: f64) -> f64 {
    // Not `max`, which would turn NaN into a perfect score.
    -20.0 * if rms < SMALLEST_RMS { SMALLEST_RMS } else { rms }.log10()
}

/// Measurements of one setting of numerical dials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Name in reports.
    pub name: String,
    /// The changed dials.
    pub turned: Setting,
    /// PSNR of its pictures against the exact ones, over all pixels of all views together, not clamped, dB. At most 300.
    pub error_db: f64,
    /// Largest error of any channel of any pixel, for colours in 0..1.
    pub max_error: f64,
    /// Relative L2 error of the gradients against the exact ones, for the parameter with the largest error; `None` where only
    /// pictures were compared.
    pub gradient_error: Option<f64>,
    /// Cosine between the gradients and the exact ones, for the parameter with the smallest cosine; `None` as above.
    pub gradient_cosine: Option<f64>,
    /// Time of a render, ms per frame.
    pub forward_ms: Spread,
    /// Time of its backward pass, ms per frame.
    pub backward_ms: Spread,
    /// Time of both together, ms per frame.
    pub step_ms: Spread,
}

/// Measurements on one scene and one device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frontier {
    /// The device, by its name in `metrics.json`.
    pub device: String,
    /// The scene, the capture and the model choices.
    pub provenance: Provenance,
    /// Number of Gaussians of the scene.
    pub splats: usize,
    /// Mean number of pixels of a frame.
    pub pixels: usize,
    /// The settings of numerical dials; one of them is [`STANDARD`].
    pub settings: Vec<Measured>,
}

/// A file that holds no valid frontier. Each message names the file and what to do.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FrontierError {
    /// The file cannot be read.
    #[error("{path}: {source}; pass the `pareto.json` that `splat pareto` wrote", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file holds something else.
    #[error("{path}: {reason}; measure again with `splat pareto`, which writes `pareto.json`", path = path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
}

/// Largest size of a file, bytes. A frontier takes about ten kilobytes.
const LARGEST_FILE: u64 = 16 << 20;

impl Frontier {
    /// Reads a file that holds the output of [`Self::to_json`].
    ///
    /// # Errors
    /// If the file cannot be read or holds something else.
    pub fn read(path: &Path) -> Result<Self, FrontierError> {
        let content = |reason| FrontierError::Content { path: path.to_owned(), reason };
        let unread = |source| FrontierError::Read { path: path.to_owned(), source };
        let found: Self = json::read(path, LARGEST_FILE, unread, content)?;
        match found.settings.as_slice() {
            [] => Err(content("no setting was measured".into())),
            settings if !settings.iter().all(Measured::is_finite) => Err(content("a number is not finite".into())),
            _ => Ok(found),
        }
    }

    /// The frontier as JSON, for a file.
    ///
    /// # Errors
    /// If a number is not finite, which JSON cannot represent.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string_pretty(self)
    }
}

impl Measured {
    fn is_finite(&self) -> bool {
        let of = |spread: &Spread| [spread.lower, spread.median, spread.upper];
        let times = [&self.forward_ms, &self.backward_ms, &self.step_ms].map(of);
        times.as_flattened().iter().chain([&self.error_db, &self.max_error]).all(|value| value.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::super::choice::tests::measured;
    use super::*;

    #[test]
    fn decibels_of_known_errors() {
        assert_eq!(decibels(0.1), 20.0);
        assert!((decibels(0.0) - 300.0).abs() < 1e-9);
        assert!(decibels(f64::NAN).is_nan());
    }

    #[test]
    fn a_frontier_survives_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pareto.json");
        // These numbers are exact as decimals; the last bit of others is not kept.
        let exact = Spread { lower: 1.5, median: 2.0, upper: 3.25 };
        let measured = measured("fast", [("alpha_min", "4/255")], 40.0, 3.0);
        let settings = vec![Measured { forward_ms: exact, backward_ms: exact, step_ms: exact, ..measured }];
        let provenance = Provenance { capture: "a1".into(), scene: "b2".into(), choices: Setting::default() };
        let frontier = Frontier { device: "flex".into(), provenance, splats: 7, pixels: 12, settings };
        fs::write(&path, frontier.to_json().unwrap()).unwrap();
        assert_eq!(Frontier::read(&path).unwrap(), frontier);
    }

    #[test]
    fn files_that_hold_no_frontier_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pareto.json");
        let refused = |path: &Path| Frontier::read(path).unwrap_err().to_string();
        assert!(refused(&path).contains("pareto.json") && refused(&path).contains("splat pareto"));
        for (text, part) in [
            ("", "EOF"),
            ("{}", "missing field"),
            // The format of frontiers before they held a provenance.
            (r#"{"device": "flex", "splats": 1, "pixels": 1, "settings": []}"#, "missing field `provenance`"),
            (
                r#"{"device": "flex", "provenance": {"capture": "", "scene": "", "choices": {}}, "splats": 1, "pixels": 1, "settings": []}"#,
                "no setting",
            ),
        ] {
            fs::write(&path, text).unwrap();
            assert!(refused(&path).contains(part), "{}", refused(&path));
        }
    }
}
