//! Brightness and white balance of the photographs, from the same points in several of them.
//!
//! The logarithm of a point's colour is taken to be what the point is plus what the photograph adds, and each in turn is the
//! median of what the other leaves: robust against points that are hidden, mirrors, and places that miss. What is common to
//! all photographs belongs to the points.

use serde::Serialize;

use super::sights::Sights;
use super::{Capture, deviation, quantile};

/// Values beyond are clipped, or all noise: their ratios say nothing.
pub(super) const USABLE: std::ops::RangeInclusive<f32> = 0.04..=0.96;

/// Rounds of medians; they settle within a few.
const ROUNDS: usize = 10;

/// A photograph with fewer points than this says nothing of its exposure.
const FEWEST_POINTS: usize = 20;

/// A photograph against the capture's median, in stops of stored (display-referred) values: log₂ of their ratio. A stop
/// of light is a half to a third of that, because files hold about the 2.2nd root of light.
#[derive(Clone, Debug, Serialize)]
pub struct ViewExposure {
    /// The photograph.
    pub name: String,
    /// By channel.
    pub stops_rgb: [f64; 3],
    /// Points that it was compared by.
    pub points: usize,
}

impl ViewExposure {
    /// The mean of the channels.
    pub fn stops(&self) -> f64 {
        self.stops_rgb.iter().sum::<f64>() / 3.0
    }
}

/// How photographs differ, in stops of stored values (see [`ViewExposure`]).
#[derive(Clone, Debug, Serialize)]
pub struct ExposureEvidence {
    /// Deviation of the photographs' mean over the channels.
    pub brightness_spread_stops: f64,
    /// Deviation of a channel from that mean, the largest of the three.
    pub white_balance_spread_stops: f64,
    /// Every photograph with enough points, by name.
    pub views: Vec<ViewExposure>,
}

/// What each photograph adds to the logarithm of a colour, natural logarithms.
pub(super) struct Fit {
    /// By view; none with too few points.
    pub views: Vec<Option<[f64; 3]>>,
    counts: Vec<usize>,
}

#[cfg(test)]
impl Fit {
    /// For tests of what is made of one.
    pub fn known(views: Vec<Option<[f64; 3]>>) -> Self {
        Self { counts: vec![FEWEST_POINTS; views.len()], views }
    }
}

pub(super) fn fit(sights: &Sights, views: usize) -> Fit {
    let mut fit = Fit { views: vec![None; views], counts: vec![0; views] };
    let usable = |value: &f32| USABLE.contains(value);
    for sight in sights.points.iter().flatten() {
        fit.counts[sight.view] += usize::from(sight.sample.is_some_and(|sample| sample.mean.iter().all(usable)));
    }
    for channel in 0..3 {
        let mut of_view = vec![0.0; views];
        let mut of_point = vec![None; sights.points.len()];
        for _ in 0..ROUNDS {
            for (point, seen) in of_point.iter_mut().zip(&sights.points) {
                let left = seen.iter().filter_map(|sight| {
                    let value = sight.sample.map(|sample| sample.mean[channel]).filter(usable)?;
                    Some(f64::from(value).ln() - of_view[sight.view])
                });
                *point = quantile(&mut left.collect::<Vec<_>>(), 0.5);
            }
            let mut left = vec![Vec::new(); views];
            for (point, seen) in of_point.iter().zip(&sights.points) {
                let Some(point) = point else { continue };
                for sight in seen {
                    let value = sight.sample.map(|sample| sample.mean[channel]).filter(usable);
                    left[sight.view].extend(value.map(|value| f64::from(value).ln() - point));
                }
            }
            let medians = left.iter_mut().map(|left| quantile(left, 0.5).unwrap_or(0.0));
            of_view = medians.collect();
            let middle = quantile(&mut of_view.clone(), 0.5).unwrap_or(0.0);
            of_view.iter_mut().for_each(|view| *view -= middle);
        }
        for (view, &count) in fit.counts.iter().enumerate() {
            if count >= FEWEST_POINTS {
                fit.views[view].get_or_insert([0.0; 3])[channel] = of_view[view];
            }
        }
    }
    fit
}

pub(super) fn evidence(capture: &Capture, fit: &Fit) -> Option<ExposureEvidence> {
    let stops = |natural: f64| natural / std::f64::consts::LN_2;
    let view = |(view, values): (usize, &Option<[f64; 3]>)| {
        let name = capture.views[view].name.clone();
        Some(ViewExposure { name, stops_rgb: (*values)?.map(stops), points: fit.counts[view] })
    };
    let views: Vec<ViewExposure> = fit.views.iter().enumerate().filter_map(view).collect();
    if views.len() < 2 {
        return None;
    }
    let brightness: Vec<f64> = views.iter().map(ViewExposure::stops).collect();
    let tint = |channel: usize| {
        let tints: Vec<f64> = views.iter().map(|view| view.stops_rgb[channel] - view.stops()).collect();
        deviation(&tints)
    };
    Some(ExposureEvidence {
        brightness_spread_stops: deviation(&brightness),
        white_balance_spread_stops: (0..3).map(tint).fold(0.0, f64::max),
        views,
    })
}
