//! Evidence from alpha channels and from files next to the photographs.

use std::path::PathBuf;

use rayon::prelude::*;
use serde::Serialize;

use super::Capture;
use super::pictures::Glance;
use crate::capture::image::has_alpha;
use crate::capture::{depth_maps, masks};

/// Alpha channels, masks and depth maps.
#[derive(Clone, Debug, Serialize)]
pub struct FileEvidence {
    /// Photographs that are not opaque everywhere. Photographs that were not decoded count if they have an alpha channel.
    pub with_alpha: usize,
    /// Photographs with a mask (see [`masks::find`]).
    pub with_mask: usize,
    /// Share of the pixels that masks exclude, over the decoded photographs with masks.
    pub masked_share: f64,
    /// The folder with depth maps of photographs, if there is one.
    pub depth_maps: Option<String>,
}

/// All files that a run on a capture may read: the capture's own, photographs, masks and depth maps.
pub fn input_files(capture: &Capture) -> Vec<PathBuf> {
    let unit = depth_maps::folder(capture).map(|folder| capture.folder.join(folder).join(depth_maps::UNIT));
    let beside = [masks::find(capture), depth_maps::find(capture)].concat();
    let photographs = capture.views.iter().map(|view| view.image_path.clone());
    capture.files.iter().cloned().chain(photographs).chain(beside.into_iter().flatten()).chain(unit).collect()
}

pub(super) fn evidence(capture: &Capture, views: &[usize], glances: &[Glance]) -> FileEvidence {
    let masked: Vec<f64> = glances.iter().filter_map(|glance| glance.masked).collect();
    let transparent = glances.iter().filter(|glance| glance.transparent).count();
    let seen = |view: &usize| glances.binary_search_by_key(view, |glance| glance.view).is_ok();
    let unseen = views.par_iter().filter(|view| !seen(view));
    FileEvidence {
        with_alpha: transparent + unseen.filter(|view| has_alpha(&capture.views[**view].image_path)).count(),
        with_mask: masks::find(capture).iter().flatten().count(),
        masked_share: masked.iter().sum::<f64>() / masked.len().max(1) as f64,
        depth_maps: depth_maps::folder(capture).map(|name| name.to_string_lossy().into_owned()),
    }
}
