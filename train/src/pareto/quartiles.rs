//! Times with their quartiles, errors in dB, and the Pareto frontier of both.

/// The median of repeated measurements and the quartiles around it.
#[derive(Clone, Copy, Debug, PartialEq)]
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

    /// Whether neither lies below the other: not measurably different, and not ranked.
    pub fn overlaps(&self, other: &Self) -> bool {
        !self.is_below(other) && !other.is_below(self)
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
mod tests {
    use super::*;

    fn point(quality_db: f64, lower: f64, upper: f64) -> (f64, Quartiles) {
        (quality_db, Quartiles { lower, median: 0.5 * (lower + upper), upper })
    }

    #[test]
    fn quartiles_are_those_of_the_textbook() {
        let of = |values: &[f64]| Quartiles::of(values).map(|found| [found.lower, found.median, found.upper]);
        assert_eq!(of(&[4.0, 1.0, 3.0, 2.0, 5.0]), Some([2.0, 3.0, 4.0]));
        assert_eq!(of(&[1.0, 2.0, 3.0, 10.0]), Some([1.75, 2.5, 4.75]));
        assert_eq!(of(&[7.0]), Some([7.0; 3]));
        assert!(of(&[]).is_none() && of(&[1.0, f64::NAN]).is_none());
    }

    #[test]
    fn quartiles_that_touch_are_not_told_apart() {
        let quartiles = |lower, upper| point(0.0, lower, upper).1;
        assert!(quartiles(1.0, 2.0).is_below(&quartiles(2.1, 3.0)));
        assert!(quartiles(1.0, 2.0).overlaps(&quartiles(2.0, 3.0)));
        assert!(quartiles(1.0, 4.0).overlaps(&quartiles(2.0, 3.0)));
    }

    #[test]
    fn decibels_of_known_errors() {
        assert_eq!(decibels(0.1), 20.0);
        assert!((decibels(0.0) - 300.0).abs() < 1e-9);
        assert!(decibels(f64::NAN).is_nan());
    }

    #[test]
    fn only_what_is_measurably_faster_is_worth_an_error() {
        // 0 is best; 1 is as fast as that; 2 is faster; 3 is faster than 2 but no better than 4; 4 is fastest.
        let points = [
            point(90.0, 9.0, 10.0),
            point(80.0, 9.5, 9.8),
            point(70.0, 5.0, 6.0),
            point(40.0, 3.0, 4.0),
            point(40.0, 1.0, 2.0),
        ];
        assert_eq!(frontier(&points), [0, 2, 4]);
        // Neighbours in this chain overlap, and its ends do not.
        let chain = [point(90.0, 5.0, 7.0), point(80.0, 4.0, 6.0), point(70.0, 3.0, 4.5)];
        assert_eq!(frontier(&chain), [0, 2]);
        assert_eq!(frontier(&[point(f64::NAN, 0.1, 0.2), point(50.0, 1.0, 2.0)]), [1]);
        assert_eq!(frontier(&[point(60.01, 5.0, 6.0), point(60.0, 1.0, 2.0)]), [1], "a hundredth is no difference");
        assert!(frontier(&[]).is_empty());
    }
}
