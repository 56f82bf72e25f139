//! Maps of depth or disparity without a unit, as networks for single pictures give them.

use serde::Deserialize;

use super::DepthSample;
use crate::capture::depth_maps::DepthMap;
use crate::quantile::quantile;

/// Least number of sparse points for scale and shift.
const LEAST_POINTS: usize = 20;

/// Largest median miss of the points, as a share of their quantity.
const LARGEST_MISS: f64 = 0.25;

/// Depths count from that of a tenth of the points, divided by this, to that of nine tenths, times this. Beyond, scale and shift are guesses:
/// for a sky above all.
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

    /// Replaces the levels of the map of a photograph by camera z, scene units, not a number where it is unknown. The quantity is
    /// `scale · level + shift`. Of the depths of sparse points in the photograph, the scale is the median over pairs, and the shift that over points
    /// (Theil 1950, Sen 1968), so that a quarter of the points may be wrong. The error says why there is none: too few points, or a map
    /// that does not grow with the quantity or does not tell their depths.
    pub fn solve(self, map: &mut DepthMap, points: &[DepthSample]) -> Result<(), String> {
        let sides = [map.width(), map.height()].map(|side| side as f32);
        let known = points.iter().filter_map(|point| {
            let [x, y] = [0, 1].map(|axis| (point.at[axis] * sides[axis]) as u32);
            let level = f64::from(map.get_pixel_checked(x, y)?.0[0]);
            let counts = level.is_finite() && level != 0.0 && point.depth > 0.0;
            counts.then(|| (level, self.turned(point.depth.into())))
        });
        let mut known: Vec<(f64, f64)> = known.collect();
        if known.len() < LEAST_POINTS {
            return Err(format!("{} sparse points where its map is known, expected {LEAST_POINTS}", known.len()));
        }
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let at = |share: f64, values: &mut dyn Iterator<Item = f64>| {
            quantile(&mut values.filter(|value| value.is_finite()).collect::<Vec<_>>(), share).unwrap_or_default()
        };
        let (low, high) = known.split_at(known.len() / 2);
        let scale = at(0.5, &mut low.iter().zip(high).map(|(a, b)| (b.1 - a.1) / (b.0 - a.0)));
        let shift = at(0.5, &mut known.iter().map(|(level, value)| value - scale * level));
        let miss = at(0.5, &mut known.iter().map(|(level, value)| ((scale * level + shift) / value - 1.0).abs()));
        if !(scale > 0.0 && miss < LARGEST_MISS) {
            return Err(format!(
                "the {self:?} of its sparse points is {scale:.2e} times a level of its map, to {:.0}%, expected a factor above 0, to {:.0}%",
                100.0 * miss,
                100.0 * LARGEST_MISS
            ));
        }
        let depth = |share| at(share, &mut known.iter().map(|point| self.turned(point.1)));
        let within = depth(0.1) / BEYOND..=depth(0.9) * BEYOND;
        for level in map.iter_mut() {
            let depth = self.turned(scale * f64::from(*level) + shift);
            *level = if *level != 0.0 && within.contains(&depth) { depth as f32 } else { f32::NAN };
        }
        Ok(())
    }
}
