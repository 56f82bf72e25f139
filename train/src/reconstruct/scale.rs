//! `--scale-from`: the size of a scene unit.

use std::fmt::{self, Display};
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use splat_model::capture::scale::{from_gps, from_marks, in_stored_pictures, parse_marks};
use splat_model::capture::{Capture, Scale};

use crate::progress;

/// File of marks beside the photographs, unless `--marks` names another.
const MARKS: &str = "marks.txt";

/// What the scale is measured from.
#[derive(Clone, Debug, PartialEq)]
pub enum ScaleFrom {
    /// GPS positions in EXIF.
    Gps,
    /// Two marked points, and the metres between them.
    Points {
        /// Names of the points.
        names: [String; 2],
        /// Their distance, m.
        distance_m: f64,
    },
}

impl FromStr for ScaleFrom {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "gps" {
            return Ok(Self::Gps);
        }
        let parsed = || {
            let (names, metres) = text.rsplit_once('=')?;
            let (a, b) = names.split_once(',')?;
            let distance_m: f64 = metres.trim().trim_end_matches('m').trim_end().parse().ok()?;
            let [a, b] = [a, b].map(|name| name.trim().to_owned());
            let known = !a.is_empty() && !b.is_empty() && a != b && distance_m.is_finite() && distance_m > 0.0;
            known.then_some(Self::Points { names: [a, b], distance_m })
        };
        parsed().ok_or_else(|| "expected `gps`, or two names and the metres between them: left,right=0.75".into())
    }
}

impl Display for ScaleFrom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gps => f.write_str("gps"),
            Self::Points { names: [a, b], distance_m } => write!(f, "{a},{b}={distance_m}"),
        }
    }
}

/// The file of marks that belongs to photographs.
pub fn marks_beside(source: &Path) -> PathBuf {
    match source.is_dir() {
        true => source.join(MARKS),
        false => source.with_file_name(MARKS),
    }
}

/// Measures the size of a capture's unit.
///
/// # Errors
/// If it cannot be determined; the message says what was found and what helps.
pub fn measure(capture: &Capture, from: &ScaleFrom, marks: &Path) -> Result<Scale> {
    let scale = match from {
        ScaleFrom::Gps => from_gps(capture)?.context("`--scale-from gps` finds no scale")?,
        ScaleFrom::Points { names: [a, b], distance_m } => {
            let text = match fs::read_to_string(marks) {
                Ok(text) => text,
                Err(error) => bail!(
                    "cannot read the marks in {}: {error}. `--scale-from {from}` needs a file with a line for each mark, `NAME PHOTOGRAPH X Y`: \
                     the points `{a}` and `{b}`, each in two photographs or more; `--marks` names another file",
                    marks.display()
                ),
            };
            from_marks(capture, &in_stored_pictures(capture, parse_marks(marks, &text)?)?, [a, b], *distance_m)
                .with_context(|| {
                    format!("`--scale-from {from}` finds no scale with the marks in {}", marks.display())
                })?
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_read_as_they_are_printed() {
        for text in ["gps", "left,right=0.75", "a b,c=2"] {
            assert_eq!(text.parse::<ScaleFrom>().unwrap().to_string(), text);
        }
        let points = |names: [&str; 2], distance_m| ScaleFrom::Points { names: names.map(str::to_owned), distance_m };
        assert_eq!("left, right = 0.75 m".parse(), Ok(points(["left", "right"], 0.75)));
        for bad in
            ["", "GPS", "left,right", "left=1", "left,right=0", "left,right=-1", "left,right=nan", "a,a=1", ",b=1"]
        {
            assert!(bad.parse::<ScaleFrom>().is_err(), "{bad}");
        }
    }
}
