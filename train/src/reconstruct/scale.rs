//! `--scale-from`: the size of a scene unit.

use anyhow::{Context, Result};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::capture::scale::from_gps;
use splat_model::capture::{Capture, Scale};

use crate::progress;

/// What the scale is measured from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScaleFrom {
    /// GPS positions in EXIF
    Gps,
}

/// Measures the size of a capture's unit.
///
/// # Errors
/// If it cannot be determined; the message says what was found and what helps.
pub fn measure(capture: &Capture, from: ScaleFrom) -> Result<Scale> {
    let scale = match from {
        ScaleFrom::Gps => from_gps(capture)?.context("`--scale-from gps` finds no scale")?,
    };
    progress::note(&said(&scale));
    Ok(scale)
}

/// Describes a scale.
pub fn said(scale: &Scale) -> String {
    let Scale { metres_per_unit, relative_deviation, source } = scale;
    let deviation = relative_deviation.map(|deviation| format!(" ±{:.1}%", 100.0 * deviation)).unwrap_or_default();
    let source = if source.is_empty() { String::new() } else { format!(", by {source}") };
    format!("a scene unit is {metres_per_unit:.4} m{deviation}{source}")
}
