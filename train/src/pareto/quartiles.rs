//! Times with their quartiles, errors in dB, and the Pareto frontier of both.

/// The median of repeated measurements and the quartiles around it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quartiles {
    pub lower: f64,
    pub median: f64,
    pub upper: f64,
}

impl Quartiles {
    /// Computes the quartiles of measurements in any order by linear interpolation (definition 7 of Hyndman and Fan 1996, which
    /// most tools use). Returns `None` without measurements, or if one is not finite.
    pub fn of(measurements: &[f64]) -> Option<Self> {
        let mut sorted = measurements.to_vec();
        sorted.sort_by(f64::total_cmp);
        let last = sorted.len().checked_sub(1)?;
        if !sorted.iter().all(|value| value.is_finite()) {
            return None;
        }
        let at = |share: f64| {
            let place = share * last as f64;
            let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
            below + (above - below) * place.fract()
        };
        Some(Self { lower: at(0.25), median: at(0.5), upper: at(0.75) })
    }

    /// Whether all quartiles lie below the other's: measurably different, and smaller.
    pub fn is_below(&self, other: &Self) -> bool {
        self.upper < other.lower
    }
}

/// Smallest error that is reported. It is below the precision of f32.
const SMALLEST_RMS: f64 = 1e-15;

/// Converts a root mean square error relative to 1 into dB: higher is better, at most 300. NaN stays NaN.
pub fn decibels(rms: f64) -> f64 {
    // Not `max`, which would turn NaN into a perfect score.
    -20.0 * if rms < SMALLEST_RMS { SMALLEST_RMS } else { rms }.log10()
}

/// Returns the indices of the points on the frontier of quality, dB, and cost, best quality first. Each is measurably cheaper than
/// all before it. Qualities are compared in tenths, so that rounding decides nothing. Points whose quality is NaN are left out.
pub fn frontier(points: &[(f64, Quartiles)]) -> Vec<usize> {
    let tenths = |i: usize| (points[i].0 * 10.0).round();
    let mut order: Vec<usize> = (0..points.len()).filter(|&i| !points[i].0.is_nan()).collect();
    order.sort_by(|&a, &b| tenths(b).total_cmp(&tenths(a)).then(points[a].1.upper.total_cmp(&points[b].1.upper)));
    let mut kept: Vec<usize> = Vec::new();
    for i in order {
        if kept.last().is_none_or(|&last| points[i].1.is_below(&points[last].1)) {
            kept.push(i);
        }
    }
    kept
}

#[cfg(test)]
mod tests;
