//! What comments of the header say about a scene: where its positions are in the world, how large its units are, and how it was trained.

use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::Header;
use serde::{Deserialize, Serialize};

use super::read::brief;
use crate::FileError;
use crate::capture::scale::is_scale;

/// Prefix of the comment that holds the origin.
pub(super) const ORIGIN_COMMENT: &str = "splat origin ";

/// Prefix of the comment that holds the size of a scene unit.
pub(super) const SCALE_COMMENT: &str = "splat metres per unit ";

/// Prefix of the comment that holds how the scene was trained.
pub(super) const TRAINED_COMMENT: &str = "splat trained as ";

/// How a scene was trained, as far as its renders depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TrainedAs {
    /// Whether opacities were compensated for the screen-space blur.
    pub antialias: bool,
    /// Whether a Gaussian contributed its largest value along a pixel's ray.
    pub ray_max: bool,
    /// Constant background, RGB, 0 to 1.
    pub background: [f32; 3],
    /// Whether light from infinity was learned instead, which `background.json` beside the scene holds.
    pub environment: bool,
}

/// Where the positions of a file are in the world, how large its units are, and how it was trained.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorldFrame {
    /// The origin that positions are relative to: `position_world = position + origin`, scene units.
    pub origin: DVec3,
    /// Metres per scene unit, finite and positive; `None` where the size is unknown.
    pub metres_per_unit: Option<f64>,
    /// How it was trained.
    pub trained: TrainedAs,
}

impl From<DVec3> for WorldFrame {
    fn from(origin: DVec3) -> Self {
        Self { origin, ..Self::default() }
    }
}

/// The frame that the comments of a header state.
pub(crate) fn world_frame(path: &Path, header: &Header) -> Result<WorldFrame, FileError> {
    let origin = comment(path, header, ORIGIN_COMMENT, "three finite numbers", |text| {
        numbers(text).filter(|numbers: &[f64; 3]| numbers.iter().all(|number| number.is_finite()))
    })?;
    let metres_per_unit = comment(path, header, SCALE_COMMENT, "a positive number", |text| {
        numbers(text).map(|[metres]| metres).filter(|metres| is_scale(*metres))
    })?;
    let expected = serde_json::to_string(&TrainedAs::default()).unwrap_or_default();
    let trained = comment(path, header, TRAINED_COMMENT, &expected, |text| {
        let trained = serde_json::from_str::<TrainedAs>(text).ok();
        trained.filter(|trained| trained.background.iter().all(|value| value.is_finite()))
    })?;
    let origin = origin.map(DVec3::from_array).unwrap_or_default();
    Ok(WorldFrame { origin, metres_per_unit, trained: trained.unwrap_or_default() })
}

/// Reads the rest of the first comment with a prefix, if there is one.
fn comment<T>(
    path: &Path,
    header: &Header,
    prefix: &str,
    expected: &str,
    read: impl Fn(&str) -> Option<T>,
) -> Result<Option<T>, FileError> {
    let text = header.comments.iter().find_map(|comment| comment.trim().strip_prefix(prefix));
    let wrong = |text| format!("comment `{prefix}{}`, expected {expected}; correct or remove that line", brief(text));
    text.map(|text| read(text).ok_or_else(|| FileError::new(path, wrong(text)))).transpose()
}

/// The numbers of a text, if there are as many.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    numbers?.try_into().ok()
}
