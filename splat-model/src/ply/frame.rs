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
    let mut world = WorldFrame::default();
    if let Some(numbers) = comment(path, header, ORIGIN_COMMENT, "three finite numbers", |numbers| {
        numbers.iter().all(|number| number.is_finite())
    })? {
        world.origin = DVec3::from_array(numbers);
    }
    let metres = comment(path, header, SCALE_COMMENT, "a positive number", |&[metres]| is_scale(metres))?;
    world.metres_per_unit = metres.map(|[metres]| metres);
    if let Some(text) = text_after(header, TRAINED_COMMENT) {
        let read = serde_json::from_str::<TrainedAs>(text).ok();
        world.trained =
            read.filter(|trained| trained.background.iter().all(|value| value.is_finite())).ok_or_else(|| {
                let expected = serde_json::to_string(&TrainedAs::default()).unwrap_or_default();
                FileError::new(
                    path,
                    format!(
                        "comment `{TRAINED_COMMENT}{}`, expected {expected}; correct or remove that line",
                        brief(text)
                    ),
                )
            })?;
    }
    Ok(world)
}

/// The rest of the first comment with a prefix, if there is one.
fn text_after<'a>(header: &'a Header, prefix: &str) -> Option<&'a str> {
    header.comments.iter().find_map(|comment| comment.trim().strip_prefix(prefix))
}

/// The numbers of the first comment with a prefix, if there is one.
fn comment<const N: usize>(
    path: &Path,
    header: &Header,
    prefix: &str,
    expected: &str,
    valid: impl Fn(&[f64; N]) -> bool,
) -> Result<Option<[f64; N]>, FileError> {
    let Some(text) = text_after(header, prefix) else { return Ok(None) };
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    match numbers.and_then(|numbers| numbers.try_into().ok()).filter(valid) {
        Some(numbers) => Ok(Some(numbers)),
        None => Err(FileError::new(
            path,
            format!("comment `{prefix}{}`, expected {expected}; correct or remove that line", brief(text)),
        )),
    }
}
