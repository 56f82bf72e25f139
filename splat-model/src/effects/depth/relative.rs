//! Depth from the levels of a map, with a known unit or with scale and shift solved from sparse points.

use serde::Deserialize;

use super::DepthSample;
use crate::capture::depth_maps::DepthMap;
use crate::quantile::quantile;

/// Least number of sparse points for scale and shift.
const LEAST_POINTS: usize = 20;

/// Most points that are compared: medians of more say the same.
const MOST_POINTS: usize = 1024;

/// Most lines through two points that are tried.
const LINES: usize = 128;

/// Largest miss of a point that counts, in medians of all.
const LARGEST_MISS: f64 = 3.0;

/// Largest share of the median miss of one depth for all that a map may leave.
const LARGEST_SHARE: f64 = 0.5;

/// Factor by which depths may lie beyond those of the points. What a map says far beyond them is a guess: for a sky above all.
const BEYOND: f64 = 2.0;

/// What the levels of a map grow with.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum Quantity {
    /// Camera z.
    Depth,
    /// The reciprocal of camera z.
    Disparity,
}

impl Quantity {
    /// The quantity of a depth, and the depth of a quantity.
    fn turned(self, value: f64) -> f64 {
        if self == Self::Depth { value } else { value.recip() }
    }
}

/// How the levels of a map tell depths.
#[derive(Clone)]
pub(super) struct Unit {
    pub quantity: Quantity,
    /// The quantity is `scale · level + shift`.
    pub scale: f64,
    pub shift: f64,
    /// Least and largest depth that counts, scene units.
    pub within: [f64; 2],
}

impl Unit {
    /// Camera z of a level, scene units. `None` where the map knows nothing, or nothing that counts.
    pub fn depth(&self, level: f32) -> Option<f32> {
        let depth = self.quantity.turned(self.scale * f64::from(level) + self.shift);
        (level.is_finite() && level != 0.0 && self.within[0] <= depth && depth <= self.within[1])
            .then_some(depth as f32)
    }

    /// The unit of the map of one photograph, from the depths of sparse points in it.
    ///
    /// The line has the least median of `|scale · level + shift − quantity| / quantity` of lines through two points, so that up to half of the points
    /// may be wrong (Rousseeuw 1984, "Least median of squares regression"), and then the least squares of the points near it.
    ///
    /// # Errors
    /// Why there is none: too few points, or a map that falls where the quantity grows, or does not tell their depths.
    pub fn solved(quantity: Quantity, map: &DepthMap, points: &[DepthSample]) -> Result<Self, String> {
        let height = map.levels.len() / map.width;
        let known = points.iter().filter_map(|point| {
            let [x, y] = [(0, map.width), (1, height)].map(|(axis, side)| (point.at[axis] * side as f32) as usize);
            let level = *map.levels.get(y * map.width + x)?;
            (level.is_finite() && level != 0.0 && point.depth > 0.0)
                .then(|| (f64::from(level), quantity.turned(point.depth.into())))
        });
        let mut known: Vec<(f64, f64)> = known.collect();
        if known.len() < LEAST_POINTS {
            return Err(format!("{} sparse points where its map is known, expected {LEAST_POINTS}", known.len()));
        }
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let known: Vec<_> = known.iter().copied().step_by(known.len().div_ceil(MOST_POINTS)).collect();
        let miss = |line: [f64; 2], (level, value): (f64, f64)| ((line[0] * level + line[1]) / value - 1.0).abs();
        let median = |line| {
            let mut misses: Vec<f64> = known.iter().map(|&point| miss(line, point)).collect();
            quantile(&mut misses, 0.5).unwrap_or(f64::INFINITY)
        };
        let half = known.len() / 2;
        let pairs = (0..half).step_by(half.div_ceil(LINES)).map(|first| [known[first], known[first + half]]);
        let tried = pairs.filter_map(|pair| line(&pair)).map(|line| (median(line), line));
        let (_, mut best) =
            tried.min_by(|a, b| a.0.total_cmp(&b.0)).ok_or("its map has the same level at all points")?;
        let near = |line| {
            let largest = LARGEST_MISS * median(line);
            known.iter().copied().filter(|&point| miss(line, point) <= largest).collect::<Vec<_>>()
        };
        for _ in 0..3 {
            best = line(&near(best)).unwrap_or(best);
        }
        let [scale, shift] = best;
        if scale <= 0.0 {
            return Err(format!("its map falls where {quantity:?} grows"));
        }
        let left = median(best);
        let same = quantile(&mut known.iter().map(|point| point.1).collect::<Vec<_>>(), 0.5).unwrap_or_default();
        if left > LARGEST_SHARE * median([0.0, same]) {
            return Err(format!("its map misses the depths of sparse points by {:.0}%", 100.0 * left));
        }
        let mut depths: Vec<f64> = near(best).iter().map(|point| quantity.turned(point.1)).collect();
        let [least, most] = [0.0, 1.0].map(|share| quantile(&mut depths, share).unwrap_or_default());
        Ok(Self { quantity, scale, shift, within: [least / BEYOND, most * BEYOND] })
    }
}

/// Slope and offset of the line that is nearest to the points, by squares of relative misses. `None` where they have one level.
fn line(points: &[(f64, f64)]) -> Option<[f64; 2]> {
    let mean = |of: &dyn Fn(f64, f64) -> f64| {
        let (sum, weight) = points.iter().fold((0.0, 0.0), |(sum, weight), &(level, value)| {
            (sum + of(level, value) / (value * value), weight + (value * value).recip())
        });
        sum / weight
    };
    let (level, value) = (mean(&|level, _| level), mean(&|_, value| value));
    let slope = mean(&|x, y| (x - level) * (y - value)) / mean(&|x, _| (x - level) * (x - level));
    slope.is_finite().then_some([slope, value - slope * level])
}
