//! Evidence from alpha channels and from files next to the photographs.

use rayon::prelude::*;
use serde::Serialize;

use super::Capture;
use super::pictures::Glance;
use crate::capture::image::has_alpha;
use crate::effects::{depth, masks};

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

pub(super) fn evidence(capture: &Capture, views: &[usize], glances: &[Glance]) -> FileEvidence {
    let masked: Vec<f64> = glances.iter().filter_map(|glance| glance.masked).collect();
    let transparent = glances.iter().filter(|glance| glance.transparent > 0.0).count();
    let seen = |view: &usize| glances.binary_search_by_key(view, |glance| glance.view).is_ok();
    let unseen = views.par_iter().filter(|view| !seen(view));
    FileEvidence {
        with_alpha: transparent + unseen.filter(|view| has_alpha(&capture.views[**view].image_path)).count(),
        with_mask: masks::find(capture).iter().flatten().count(),
        masked_share: masked.iter().sum::<f64>() / masked.len().max(1) as f64,
        depth_maps: depth::folder(capture).map(|name| name.to_string_lossy().into_owned()),
    }
}
