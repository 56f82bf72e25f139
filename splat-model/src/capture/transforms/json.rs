//! The files as written. Other fields are skipped while they are read, because a tree of the file may take a hundred times its size.

use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::error::Category;

use crate::capture::read::{Place, quoted};
use crate::capture::{CaptureError, Result};
use crate::ply::brief;

/// The expected form of a `transform_matrix`.
pub(super) const MATRIX: &str = "3 or 4 rows of 4 finite numbers, the fourth 0 0 0 1";

/// The known fields of a file or of one of its frames. `null` counts as absent.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, expecting = "an object")]
pub(in crate::capture) struct Fields {
    pub frames: Option<Vec<Fields>>,
    pub ply_file_path: Option<String>,
    pub train_filenames: Option<Vec<String>>,
    pub val_filenames: Option<Vec<String>>,
    pub test_filenames: Option<Vec<String>>,
    pub file_path: Option<String>,
    pub mask_path: Option<String>,
    pub transform_matrix: Option<Vec<Vec<f64>>>,
    pub camera_model: Option<String>,
    pub is_fisheye: Option<bool>,
    pub camera_angle_x: Option<f64>,
    pub camera_angle_y: Option<f64>,
    pub fl_x: Option<f64>,
    pub fl_y: Option<f64>,
    pub cx: Option<f64>,
    pub cy: Option<f64>,
    pub w: Option<f64>,
    pub h: Option<f64>,
    pub k1: Option<f64>,
    pub k2: Option<f64>,
    pub p1: Option<f64>,
    pub p2: Option<f64>,
    pub k3: Option<f64>,
    pub k4: Option<f64>,
    pub k5: Option<f64>,
    pub k6: Option<f64>,
    pub sx1: Option<f64>,
    pub sy1: Option<f64>,
}

impl Fields {
    /// Four rows; a missing last row is 0 0 0 1.
    pub fn matrix(&self, place: &Place) -> Result<[[f64; 4]; 4]> {
        let refuse = |found: String| place.refuse("transform_matrix", found, MATRIX);
        let rows = self.transform_matrix.as_deref().ok_or_else(|| refuse("missing".into()))?;
        let four = |row: &Vec<f64>| {
            <[f64; 4]>::try_from(&row[..]).map_err(|_| refuse(format!("a row of {} numbers", row.len())))
        };
        let mut rows = rows.iter().map(four).collect::<Result<Vec<_>, _>>()?;
        if rows.len() == 3 {
            rows.push([0.0, 0.0, 0.0, 1.0]);
        }
        rows.try_into().map_err(|rows: Vec<_>| refuse(format!("{} rows", rows.len())))
    }
}

/// Reads JSON. Errors say where the file is wrong.
pub(super) fn parse<T: DeserializeOwned>(file: &Path, bytes: &[u8]) -> Result<T> {
    let mut input = serde_json::Deserializer::from_slice(bytes);
    let read = serde_path_to_error::deserialize(&mut input);
    let ended = |value| input.end().map(|()| value).map_err(|error| (String::new(), error));
    read.map_err(|error| (error.path().to_string(), error.into_inner())).and_then(ended).map_err(|(path, error)| {
        let (line, column, reason) = (error.line(), error.column(), error.to_string());
        let reason = reason.split(" at line ").next().unwrap_or_default();
        let (field, found, expected) = match (error.classify(), reason.split_once(", expected ")) {
            (Category::Data, Some((found, "f64"))) => ("value", found, "a number"),
            (Category::Data, Some((found, expected))) => ("value", found, expected),
            (Category::Data, None) => ("value", reason, "all fields of the format"),
            _ => ("text", reason, "JSON with numbers that are finite"),
        };
        let (path, found) = (brief(&path.escape_debug().to_string()), quoted(found.trim_start_matches("invalid type: ")));
        let detail = format!(
            "{path} on line {line}, column {column}: `{field}` is {found}, expected {expected}. Correct the file, or export it again"
        );
        CaptureError::content(file, detail)
    })
}
