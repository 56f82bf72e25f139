//! Depth from the levels of a map, with a known unit or with scale and shift solved from sparse points.

use serde::Deserialize;

use super::DepthSample;
use crate::capture::depth_maps::DepthMap;
use crate::quantile::quantile;

/// Least number of sparse points for scale and shift.
const LEAST_POINTS: usize = 20;

/// Largest median miss of the points, as a share of their quantity.
const LARGEST_MISS: f64 = 0.25;

/// Depths that count reach from that of a tenth of the points, divided by this, to that of nine tenths, times this. Beyond, scale and shift
/// are guesses: for a sky above all.
const BEYOND: f64 = 2.0;

/// What the levels of a map grow with: camera z, or its reciprocal.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
pub(super) enum Quantity {
    Depth,
    Disparity,
}

impl Quantity {
    /// The quantity of a depth, and the depth of a quantity.
    fn turned(self, value: f64) -> f64 {
        if self == Self::Depth { value } else { value.recip() }
    }
}

/// How the levels of a map tell depths.
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
        let counts = level != 0.0 && self.within[0] <= depth && depth <= self.within[1];
        counts.then_some(depth as f32)
    }

    /// The unit of the map of one photograph, from the depths of sparse points in it. The scale is the median over pairs of points, and the shift
    /// that over points (Theil 1950, Sen 1968), so that a quarter of the points may be wrong.
    ///
    /// # Errors
    /// Why there is none: too few points, or a map that does not grow with the quantity or does not tell their depths.
    pub fn solved(quantity: Quantity, map: &DepthMap, points: &[DepthSample]) -> Result<Self, String> {
        let sides = [map.width, map.levels.len() / map.width].map(|side| side as f32);
        let known = points.iter().filter_map(|point| {
            let [x, y] = [0, 1].map(|axis| (point.at[axis] * sides[axis]) as usize);
            let level = map.levels.get(y * map.width + x).filter(|level| level.is_finite() && **level != 0.0)?;
            (point.depth > 0.0).then(|| (f64::from(*level), quantity.turned(point.depth.into())))
        });
        let mut known: Vec<(f64, f64)> = known.collect();
        if known.len() < LEAST_POINTS {
            return Err(format!("{} sparse points where its map is known, expected {LEAST_POINTS}", known.len()));
        }
        let of_points = |share: f64, values: &mut dyn Iterator<Item = f64>| {
            quantile(&mut values.filter(|value| value.is_finite()).collect::<Vec<_>>(), share).unwrap_or_default()
        };
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (low, high) = known.split_at(known.len() / 2);
        let scale = of_points(0.5, &mut low.iter().zip(high).map(|(a, b)| (b.1 - a.1) / (b.0 - a.0)));
        let shift = of_points(0.5, &mut known.iter().map(|(level, value)| value - scale * level));
        let miss =
            of_points(0.5, &mut known.iter().map(|(level, value)| ((scale * level + shift) / value - 1.0).abs()));
        if !(scale > 0.0 && miss < LARGEST_MISS) {
            return Err(format!(
                "the {quantity:?} of its sparse points is {scale:.2e} times a level of its map, to {:.0}%, expected a factor above 0, to {:.0}%",
                100.0 * miss,
                100.0 * LARGEST_MISS
            ));
        }
        let depth = |share| of_points(share, &mut known.iter().map(|point| quantity.turned(point.1)));
        Ok(Self { quantity, scale, shift, within: [depth(0.1) / BEYOND, depth(0.9) * BEYOND] })
    }
}
