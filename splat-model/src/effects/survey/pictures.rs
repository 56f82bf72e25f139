//! Evidence that requires decoded photographs: colours at the compared points, sharpness, alpha.

use rayon::prelude::*;

use super::detail::Detail;
use super::observations::{ColourSample, PointObservations};
use crate::capture::image::load;
use crate::capture::{Capture, Photo, Result};
use crate::effects::masks;

pub(super) struct Glance {
    /// Index of the photograph.
    pub view: usize,
    /// See [`super::BlurEvidence`]. `None` for a picture of one colour.
    pub sharpness: Option<f64>,
    /// Whether a part of the picture is not opaque.
    pub transparent: bool,
    /// Share of the picture that a mask excludes. `None` without a mask.
    pub masked: Option<f64>,
}

/// Decodes each photograph once, stores the samples of its observations, and discards its pixels.
pub(super) fn look(capture: &Capture, surveyed: &[usize], observations: &mut PointObservations) -> Result<Vec<Glance>> {
    let mut places: Vec<Vec<(usize, usize)>> = vec![Vec::new(); capture.views.len()];
    for (point, seen) in observations.points.iter().enumerate() {
        for (i, observation) in seen.iter().enumerate() {
            places[observation.view].push((point, i));
        }
    }
    let found = masks::find(capture);
    let one = |&view: &usize| {
        let mut photo = load(&capture.views[view], None)?;
        // An unusable mask is no evidence here. It is an error in training.
        photo.mask = found[view].as_ref().and_then(|file| masks::load(file, &capture.views[view]).ok());
        let sample = |&(point, i): &(usize, usize)| (point, i, sample(&photo, observations.points[point][i].at_px));
        let samples: Vec<(usize, usize, Option<ColourSample>)> = places[view].iter().map(sample).collect();
        let glance = Glance {
            view,
            sharpness: super::detail::sharpness(&photo),
            transparent: photo.alpha.as_deref().is_some_and(|alpha| alpha.iter().any(|&alpha| alpha != u8::MAX)),
            masked: photo.mask.as_deref().map(masks::excluded_share),
        };
        Ok((glance, samples))
    };
    let seen: Vec<(Glance, Vec<_>)> = surveyed.par_iter().map(one).collect::<Result<_>>()?;
    let (glances, samples): (Vec<Glance>, Vec<Vec<_>>) = seen.into_iter().unzip();
    for (point, i, sample) in samples.into_iter().flatten() {
        observations.points[point][i].sample = sample;
    }
    Ok(glances)
}

/// Samples the colours around a position. `None` within two pixels of the border, and where the picture is transparent or masked.
fn sample(photo: &Photo, at_px: [f64; 2]) -> Option<ColourSample> {
    let (width, height) = (photo.intrinsics.width, photo.intrinsics.height);
    // Compared before the conversion to integers: a damaged file may place a keypoint anywhere.
    let inside = |px: f64, side: usize| px >= 2.0 && px < side as f64 - 2.0;
    if !(inside(at_px[0], width) && inside(at_px[1], height)) {
        return None;
    }
    let [x, y] = at_px.map(|px| px as usize);
    let detail = Detail::around(photo, [x, y]);
    let mut sample = ColourSample { mean: [0.0; 3], low: [1.0; 3], high: [0.0; 3], detail };
    for row in y - 2..=y + 2 {
        for column in x - 2..=x + 2 {
            let at = row * width + column;
            let transparent = photo.alpha.as_ref().is_some_and(|alpha| alpha[at] != u8::MAX);
            if transparent || photo.mask.as_ref().is_some_and(|mask| !mask[at]) {
                return None;
            }
            let inner = row.abs_diff(y) <= 1 && column.abs_diff(x) <= 1;
            for channel in 0..3 {
                let value = f32::from(photo.rgb[3 * at + channel]) / 255.0;
                sample.low[channel] = sample.low[channel].min(value);
                sample.high[channel] = sample.high[channel].max(value);
                sample.mean[channel] += if inner { value / 9.0 } else { 0.0 };
            }
        }
    }
    Some(sample)
}
