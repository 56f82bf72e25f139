//! Where a file's positions are in the world and how large its units are: two comments of the header.

use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::Header;

use super::PlyError;
use super::read::{brief, layout_error};
use crate::capture::scale::is_scale;

/// Prefix of the comment that holds the origin.
pub(super) const ORIGIN_COMMENT: &str = "splat origin ";

/// Prefix of the comment that holds the size of a scene unit.
pub(super) const SCALE_COMMENT: &str = "splat metres per unit ";

/// Where the positions of a file are in the world, and how large its units are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorldFrame {
    /// The origin that positions are relative to: `position_world = position + origin`, scene units.
    pub origin: DVec3,
    /// Metres per scene unit, finite and positive; `None` where the size is unknown.
    pub metres_per_unit: Option<f64>,
}

impl From<DVec3> for WorldFrame {
    fn from(origin: DVec3) -> Self {
        Self { origin, metres_per_unit: None }
    }
}

/// The frame that the comments of a header state.
pub(crate) fn world_frame(path: &Path, header: &Header) -> Result<WorldFrame, PlyError> {
    let mut world = WorldFrame::default();
    if let Some(numbers) = comment(path, header, ORIGIN_COMMENT, "three finite numbers", |numbers| {
        numbers.iter().all(|number| number.is_finite())
    })? {
        world.origin = DVec3::from_array(numbers);
    }
    let metres = comment(path, header, SCALE_COMMENT, "a positive number", |&[metres]| is_scale(metres))?;
    world.metres_per_unit = metres.map(|[metres]| metres);
    Ok(world)
}

/// The numbers of the first comment with a prefix, if there is one.
fn comment<const N: usize>(
    path: &Path,
    header: &Header,
    prefix: &str,
    expected: &str,
    valid: impl Fn(&[f64; N]) -> bool,
) -> Result<Option<[f64; N]>, PlyError> {
    let Some(text) = header.comments.iter().find_map(|comment| comment.trim().strip_prefix(prefix)) else {
        return Ok(None);
    };
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    match numbers.and_then(|numbers| numbers.try_into().ok()).filter(valid) {
        Some(numbers) => Ok(Some(numbers)),
        None => Err(layout_error(
            path,
            format!("comment `{prefix}{}`, expected {expected}; correct or remove that line", brief(text)),
        )),
    }
}
