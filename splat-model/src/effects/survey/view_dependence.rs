//! Colours that change with the viewing direction, after exposure correction.

use serde::Serialize;

use super::exposure::Fit;
use super::{ColourSample, PointObservation, PointObservations, quantile};

/// Smallest number of comparable photographs of a point. With fewer, the outliers could be fewer than three, which an occluder could cause.
const FEWEST_OBSERVATIONS: usize = 9;

const MOST_OBSERVATIONS: f64 = 2.0 / 3.0;

/// Largest usable value. Brighter values are close to clipping, where exposure does not scale them.
const BRIGHTEST: f32 = 250.0 / 255.0;

/// Differences between a point's colour and its median over the photographs, beyond what a shift by two pixels could
/// explain. The difference of a point is the one that is exceeded in a third of its photographs, in the worst channel, in
/// display-referred values of 0 to 1.
#[derive(Clone, Debug, Serialize)]
pub struct ViewDependenceEvidence {
    /// Median over the points.
    pub median: f64,
    /// Quantile of 90%.
    pub tenth_strongest: f64,
    /// Share of points whose difference exceeds [`ViewDependenceEvidence::VISIBLE`].
    pub visible_share: f64,
    /// Number of compared points.
    pub points: usize,
}

impl ViewDependenceEvidence {
    /// Smallest visible difference: five levels of 255. Smaller ones are within the effects of noise and JPEG.
    pub const VISIBLE: f64 = 0.02;
}

/// A sample, and its photograph's offset to the logarithm of a colour.
type ExposedSample = (ColourSample, [f64; 3]);

pub(super) fn evidence(observations: &PointObservations, fit: &Fit) -> Option<ViewDependenceEvidence> {
    let stray = |observations: &Vec<PointObservation>| -> Option<f64> {
        let seen =
            observations.iter().filter_map(|observation| Some((observation.sample?, fit.views[observation.view]?)));
        let seen: Vec<ExposedSample> = seen.collect();
        (seen.len() >= FEWEST_OBSERVATIONS)
            .then(|| (0..3).filter_map(|channel| strays_by(&seen, channel)).reduce(f64::max))?
    };
    let mut strays: Vec<f64> = observations.points.iter().filter_map(stray).collect();
    let visible = strays.iter().filter(|&&stray| stray > ViewDependenceEvidence::VISIBLE).count();
    Some(ViewDependenceEvidence {
        median: quantile(&mut strays, 0.5)?,
        tenth_strongest: quantile(&mut strays, 0.9)?,
        visible_share: visible as f64 / strays.len() as f64,
        points: strays.len(),
    })
}

/// One point in one channel.
fn strays_by(seen: &[ExposedSample], channel: usize) -> Option<f64> {
    let unexposed = |(sample, exposure): &ExposedSample| f64::from(sample.mean[channel]) * (-exposure[channel]).exp();
    let seen: Vec<&ExposedSample> = seen.iter().filter(|(sample, _)| sample.high[channel] < BRIGHTEST).collect();
    if seen.len() < FEWEST_OBSERVATIONS {
        return None;
    }
    let middle = quantile(&mut seen.iter().map(|&seen| unexposed(seen)).collect::<Vec<_>>(), 0.5)?;
    let beyond = |(sample, exposure): &ExposedSample| {
        let expected = middle * exposure[channel].exp();
        (expected - expected.clamp(sample.low[channel].into(), sample.high[channel].into())).abs()
    };
    quantile(&mut seen.iter().map(|&seen| beyond(seen)).collect::<Vec<_>>(), MOST_OBSERVATIONS)
}
