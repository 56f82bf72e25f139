//! Colours that change with the direction of view, after exposure is removed.

use serde::Serialize;

use super::exposure::Fit;
use super::quantile;
use super::sights::{Sample, Sight, Sights};

/// Photographs of a point that must be comparable: fewer than three strays may be things that hide it.
const FEWEST_SIGHTS: usize = 9;

/// Share of a point's photographs in which it strays no further.
const MOST_SIGHTS: f64 = 2.0 / 3.0;

/// What is brighter in a photograph is at its limit, and says nothing: exposure does not move it as it does others.
const BRIGHTEST: f32 = 250.0 / 255.0;

/// How far the colour of a point strays from its median over the photographs, beyond what moving by two pixels could
/// explain: exceeded in a third of its photographs, in the worst channel, in display-referred values of 0 to 1.
#[derive(Clone, Debug, Serialize)]
pub struct ViewDependenceEvidence {
    /// Half of the points stray less.
    pub median: f64,
    /// Nine of ten do.
    pub tenth_strongest: f64,
    /// Share of points that stray by more than [`ViewDependenceEvidence::VISIBLE`].
    pub visible_share: f64,
    /// Points that could be compared.
    pub points: usize,
}

impl ViewDependenceEvidence {
    /// Five levels of 255: less is not seen, and within what noise and JPEG do.
    pub const VISIBLE: f64 = 0.02;
}

/// A sample, and what its photograph adds to the logarithm of a colour.
type Seen = (Sample, [f64; 3]);

pub(super) fn evidence(sights: &Sights, fit: &Fit) -> Option<ViewDependenceEvidence> {
    let stray = |sights: &Vec<Sight>| -> Option<f64> {
        let seen = sights.iter().filter_map(|sight| Some((sight.sample?, fit.views[sight.view]?)));
        let seen: Vec<Seen> = seen.collect();
        (seen.len() >= FEWEST_SIGHTS)
            .then(|| (0..3).filter_map(|channel| strays_by(&seen, channel)).reduce(f64::max))?
    };
    let mut strays: Vec<f64> = sights.points.iter().filter_map(stray).collect();
    let visible = strays.iter().filter(|&&stray| stray > ViewDependenceEvidence::VISIBLE).count();
    Some(ViewDependenceEvidence {
        median: quantile(&mut strays, 0.5)?,
        tenth_strongest: quantile(&mut strays, 0.9)?,
        visible_share: visible as f64 / strays.len() as f64,
        points: strays.len(),
    })
}

/// One point in one channel.
fn strays_by(seen: &[Seen], channel: usize) -> Option<f64> {
    let unexposed = |(sample, exposure): &Seen| f64::from(sample.mean[channel]) * (-exposure[channel]).exp();
    let seen: Vec<&Seen> = seen.iter().filter(|(sample, _)| sample.high[channel] < BRIGHTEST).collect();
    if seen.len() < FEWEST_SIGHTS {
        return None;
    }
    let middle = quantile(&mut seen.iter().map(|&seen| unexposed(seen)).collect::<Vec<_>>(), 0.5)?;
    let beyond = |(sample, exposure): &Seen| {
        let expected = middle * exposure[channel].exp();
        (expected - expected.clamp(sample.low[channel].into(), sample.high[channel].into())).abs()
    };
    quantile(&mut seen.iter().map(|&seen| beyond(seen)).collect::<Vec<_>>(), MOST_SIGHTS)
}
