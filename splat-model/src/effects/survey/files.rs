//! What lies beside the pictures or in their alpha channels.

use rayon::prelude::*;
use serde::Serialize;

use super::pictures::Glance;
use super::{Capture, CaptureError};
use crate::effects::masks;

/// Folders in which tools put depth maps.
const DEPTH_FOLDERS: [&str; 4] = ["depth", "depths", "depth_maps", "stereo/depth_maps"];

/// Files that say more of photographs than their colours.
#[derive(Clone, Debug, Serialize)]
pub struct FileEvidence {
    /// Surveyed photographs that are not opaque everywhere.
    pub with_alpha: usize,
    /// Photographs with a mask (see [`masks::find`]).
    pub with_mask: usize,
    /// Share of the pixels of surveyed photographs with masks that these exclude.
    pub masked_share: f64,
    /// A folder with depth maps, if there is one.
    pub depth_maps: Option<String>,
}

pub(super) fn evidence(
    capture: &Capture,
    surveyed: &[usize],
    glances: &[Glance],
) -> Result<FileEvidence, CaptureError> {
    let found = masks::find(capture);
    let share = |&view: &usize| {
        let file = found[view].as_ref()?;
        let camera = &capture.views[view].intrinsics;
        Some(masks::load(file, camera).map(|mask| masks::excluded_share(&mask)))
    };
    let shares: Vec<f64> = surveyed.par_iter().filter_map(share).collect::<Result<_, _>>()?;
    let depth_maps = DEPTH_FOLDERS.into_iter().find(|name| capture.folder.join(name).is_dir());
    Ok(FileEvidence {
        with_alpha: glances.iter().filter(|glance| glance.transparent > 0.0).count(),
        with_mask: found.iter().flatten().count(),
        masked_share: shares.iter().sum::<f64>() / shares.len().max(1) as f64,
        depth_maps: depth_maps.map(str::to_owned),
    })
}
