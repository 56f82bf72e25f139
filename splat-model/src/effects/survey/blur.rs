//! Sharpness of the pictures.

use serde::Serialize;

use super::pictures::Glance;
use super::{Capture, quantile};
use crate::capture::Photo;

/// How sharp pictures are: the energy of differences between neighbouring pixels by that between pixels two apart. 0.25 for
/// a smooth picture, 1 for noise, whatever the contrast; what it is for sharp pictures depends on what they show, so it is
/// compared within a capture.
#[derive(Clone, Debug, Serialize)]
pub struct BlurEvidence {
    /// Of the pictures.
    pub median: Option<f64>,
    /// Of the twentieth part that is least sharp.
    pub least: Option<f64>,
    /// The least sharp picture.
    pub least_sharp: Option<String>,
}

pub(super) fn evidence(capture: &Capture, glances: &[Glance]) -> BlurEvidence {
    let known = glances.iter().filter_map(|glance| Some((glance.view, glance.sharpness?)));
    let least_sharp = known.clone().min_by(|a, b| a.1.total_cmp(&b.1));
    let mut values: Vec<f64> = known.map(|(_, sharpness)| sharpness).collect();
    BlurEvidence {
        median: quantile(&mut values, 0.5),
        least: quantile(&mut values, 0.05),
        least_sharp: least_sharp.map(|(view, _)| capture.views[view].name.clone()),
    }
}

/// Of the green channel, which every camera measures best. None where nothing differs.
pub(super) fn sharpness(photo: &Photo) -> Option<f64> {
    let (width, height) = (photo.intrinsics.width, photo.intrinsics.height);
    let green = |x: usize, y: usize| i64::from(photo.rgb[3 * (y * width + x) + 1]);
    let (mut near, mut far) = (0, 0);
    for y in 0..height.saturating_sub(2) {
        for x in 0..width.saturating_sub(2) {
            let here = green(x, y);
            near += (green(x + 1, y) - here).pow(2) + (green(x, y + 1) - here).pow(2);
            far += (green(x + 2, y) - here).pow(2) + (green(x, y + 2) - here).pow(2);
        }
    }
    (far > 0).then(|| near as f64 / far as f64)
}
