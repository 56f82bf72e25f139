//! Brightness and white balance of the photographs, from the same points in several of them.
//!
//! The logarithm of a point's colour is modelled as the point's own value plus an offset of the photograph. Alternating
//! medians of the residuals find both, which is robust against hidden points, mirrors and wrong positions. An offset that
//! all photographs have in common belongs to the points.

use serde::Serialize;

use super::{Capture, PointObservations, deviation, quantile};

/// Range of usable values. Values outside are clipped or mostly noise.
pub(super) const USABLE: std::ops::RangeInclusive<f32> = 0.04..=0.96;

/// Iterations of the medians, which converge within a few.
const ROUNDS: usize = 10;

/// Smallest number of points for the exposure of a photograph.
const FEWEST_POINTS: usize = 20;

/// The exposure of a photograph relative to the capture's median, in stops of stored (display-referred) values: log₂ of the ratio. A stop
/// of light is a half to a third of a stop of stored values, because files hold about the 2.2nd root of light.
#[derive(Clone, Debug, Serialize)]
pub struct ViewExposure {
    /// Name of the photograph.
    pub name: String,
    /// Stops by channel.
    pub stops_rgb: [f64; 3],
    /// Number of compared points.
    pub points: usize,
}

impl ViewExposure {
    /// The mean over the channels.
    pub fn stops(&self) -> f64 {
        self.stops_rgb.iter().sum::<f64>() / 3.0
    }
}

/// Exposure differences between photographs, in stops of stored values (see [`ViewExposure`]).
#[derive(Clone, Debug, Serialize)]
pub struct ExposureEvidence {
    /// Standard deviation of the photographs' brightness, which is the mean over the channels.
    pub brightness_spread_stops: f64,
    /// Standard deviation of a channel's difference from the brightness, the largest of the three channels.
    pub white_balance_spread_stops: f64,
    /// All photographs with enough points.
    pub views: Vec<ViewExposure>,
}

/// The offset of each photograph to the natural logarithm of a colour.
pub(super) struct Fit {
    /// Offsets by view. `None` for views with too few points.
    pub views: Vec<Option<[f64; 3]>>,
    /// Numbers of compared points by view.
    pub counts: Vec<usize>,
}

pub(super) fn fit(observations: &PointObservations, views: usize) -> Fit {
    let mut fit = Fit { views: vec![None; views], counts: vec![0; views] };
    let usable = |value: &f32| USABLE.contains(value);
    for observation in observations.points.iter().flatten() {
        fit.counts[observation.view] +=
            usize::from(observation.sample.is_some_and(|sample| sample.mean.iter().all(usable)));
    }
    for channel in 0..3 {
        let mut of_view = vec![0.0; views];
        let mut of_point = vec![None; observations.points.len()];
        for _ in 0..ROUNDS {
            for (point, seen) in of_point.iter_mut().zip(&observations.points) {
                let left = seen.iter().filter_map(|observation| {
                    let value = observation.sample.map(|sample| sample.mean[channel]).filter(usable)?;
                    Some(f64::from(value).ln() - of_view[observation.view])
                });
                *point = quantile(&mut left.collect::<Vec<_>>(), 0.5);
            }
            let mut left = vec![Vec::new(); views];
            for (point, seen) in of_point.iter().zip(&observations.points) {
                let Some(point) = point else { continue };
                for observation in seen {
                    let value = observation.sample.map(|sample| sample.mean[channel]).filter(usable);
                    left[observation.view].extend(value.map(|value| f64::from(value).ln() - point));
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
