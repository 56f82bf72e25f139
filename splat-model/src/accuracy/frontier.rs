//! Times with their spread, and the Pareto frontier of several settings.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};

/// The median of repeated measurements and the quartiles around it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Lower quartile: a quarter of the measurements are smaller.
    pub lower: f64,
    /// Median: half of the measurements are smaller.
    pub median: f64,
    /// Upper quartile: a quarter of the measurements are larger.
    pub upper: f64,
}

impl Spread {
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

    /// The spread of measurements `factor` times as large, where `factor` is positive.
    pub fn scaled(self, factor: f64) -> Self {
        Self { lower: factor * self.lower, median: factor * self.median, upper: factor * self.upper }
    }

    /// Whether the whole spread lies below the other: measurably different, and smaller.
    pub fn is_below(&self, other: &Self) -> bool {
        self.upper < other.lower
    }

    /// Whether neither spread lies below the other: not measurably different, and not ranked.
    pub fn overlaps(&self, other: &Self) -> bool {
        !self.is_below(other) && !other.is_below(self)
    }
}

/// Quality and time of a setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontierPoint {
    /// Quality, dB; higher is better. Comparisons use tenths, so that rounding decides nothing. Not NaN.
    pub quality_db: f64,
    /// Time, in any unit.
    pub time: Spread,
}

/// Quality in tenths of a dB, the unit of comparisons.
pub(super) fn tenths(quality_db: f64) -> f64 {
    (quality_db * 10.0).round()
}

/// Returns the indices of the points on the frontier, best quality first. Each is measurably faster than all before it. For
/// each point left out, another point is at least as good and not measurably slower. Points whose quality is NaN are left out.
pub fn frontier(points: &[FrontierPoint]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).filter(|&i| !points[i].quality_db.is_nan()).collect();
    let compare = |&a: &usize, &b: &usize| -> Ordering {
        let (a, b) = (&points[a], &points[b]);
        let quality = tenths(b.quality_db).total_cmp(&tenths(a.quality_db));
        let time = a.time.upper.total_cmp(&b.time.upper).then(a.time.lower.total_cmp(&b.time.lower));
        quality.then(time).then(b.quality_db.total_cmp(&a.quality_db))
    };
    order.sort_by(compare);
    let mut kept: Vec<usize> = Vec::new();
    for i in order {
        if kept.last().is_none_or(|&last| points[i].time.is_below(&points[last].time)) {
            kept.push(i);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn point(quality_db: f64, lower: f64, upper: f64) -> FrontierPoint {
        FrontierPoint { quality_db, time: Spread { lower, median: 0.5 * (lower + upper), upper } }
    }

    #[test]
    fn quartiles_are_those_of_the_textbook() {
        let spread = Spread::of(&[4.0, 1.0, 3.0, 2.0, 5.0]).unwrap();
        assert_eq!((spread.lower, spread.median, spread.upper), (2.0, 3.0, 4.0));
        let spread = Spread::of(&[1.0, 2.0, 3.0, 10.0]).unwrap();
        assert_eq!((spread.lower, spread.median, spread.upper), (1.75, 2.5, 4.75));
        assert_eq!(Spread::of(&[7.0]), Some(Spread { lower: 7.0, median: 7.0, upper: 7.0 }));
        assert!(Spread::of(&[]).is_none() && Spread::of(&[1.0, f64::NAN]).is_none());
    }

    #[test]
    fn spreads_that_touch_are_not_told_apart() {
        let spread = |lower, upper| point(0.0, lower, upper).time;
        assert!(spread(1.0, 2.0).is_below(&spread(2.1, 3.0)));
        assert!(!spread(1.0, 2.0).is_below(&spread(2.0, 3.0)) && spread(1.0, 2.0).overlaps(&spread(2.0, 3.0)));
        assert!(spread(1.0, 4.0).overlaps(&spread(2.0, 3.0)));
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
        assert!(frontier(&[]).is_empty());
    }

    #[test]
    fn a_hundredth_of_a_decibel_is_no_difference() {
        assert_eq!(frontier(&[point(60.01, 5.0, 6.0), point(60.0, 1.0, 2.0)]), [1]);
    }

    fn points() -> impl Strategy<Value = Vec<FrontierPoint>> {
        let one = (0_u8..60, 1_u8..40, 0_u8..10).prop_map(|(quality, lower, width)| {
            point(f64::from(quality) / 20.0 + 40.0, f64::from(lower), f64::from(lower) + f64::from(width))
        });
        prop::collection::vec(one, 0..24)
    }

    proptest! {
        #[test]
        fn members_trade_quality_for_time(points in points()) {
            let members = frontier(&points);
            prop_assert_eq!(members.is_empty(), points.is_empty());
            for pair in members.windows(2) {
                let (before, after) = (&points[pair[0]], &points[pair[1]]);
                prop_assert!(after.time.is_below(&before.time));
                prop_assert!(tenths(after.quality_db) < tenths(before.quality_db));
            }
        }

        #[test]
        fn whoever_is_left_out_is_replaced(points in points()) {
            let members = frontier(&points);
            for i in (0..points.len()).filter(|i| !members.contains(i)) {
                let better = |&m: &usize| tenths(points[m].quality_db) >= tenths(points[i].quality_db)
                    && !points[i].time.is_below(&points[m].time);
                prop_assert!(members.iter().any(better), "{:?} has no one better in {:?}", points[i], members);
            }
        }

        #[test]
        fn the_order_in_which_points_come_changes_nothing(points in points()) {
            let mut turned = points.clone();
            turned.reverse();
            let of = |points: &[FrontierPoint]| frontier(points).into_iter().map(|i| points[i]).collect::<Vec<_>>();
            prop_assert_eq!(of(&points), of(&turned));
        }

        #[test]
        fn a_spread_holds_its_median(values in prop::collection::vec(-1e3_f64..1e3, 1..20)) {
            let spread = Spread::of(&values).unwrap();
            prop_assert!(spread.lower <= spread.median && spread.median <= spread.upper);
            let below = values.iter().filter(|&&value| value < spread.median).count();
            prop_assert!(2 * below <= values.len());
        }
    }
}
