//! Where the cameras of a capture are, without strays.

use glam::DVec3;

use crate::quantile::quantile;

/// Share of the cameras by whose distances from the median a stray is told: three of ten may be anywhere.
const USUAL: f64 = 0.7;

/// A camera further from the median than this multiple of the distance within which the usual ones lie is a stray. The farthest camera of
/// the captures of `docs/CAPTURES.md`, and of rings, lines, grids and spheres, is 1.0 to 2.8 times that distance away.
const REACH: f64 = 5.0;

/// The centres of a capture's cameras without strays, which no statistic over cameras may follow: an unaligned photograph at zero, or one
/// far away.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spread {
    /// Mean centre, in the frame of the centres.
    pub middle: DVec3,
    /// Largest distance of a centre from it.
    pub radius: f64,
    median: DVec3,
    reach: f64,
}

impl Spread {
    /// Finds where most of these centres are. `None` if none is finite.
    pub fn of(centres: &[DVec3]) -> Option<Self> {
        let finite: Vec<DVec3> = centres.iter().copied().filter(|centre| centre.is_finite()).collect();
        let along = |axis: usize| quantile(&mut finite.iter().map(|centre| centre[axis]).collect::<Vec<_>>(), 0.5);
        let median = DVec3::new(along(0)?, along(1)?, along(2)?);
        let mut distances: Vec<f64> = finite.iter().map(|centre| centre.distance(median)).collect();
        let reach = REACH * quantile(&mut distances, USUAL)?;
        let mut spread = Self { middle: median, radius: 0.0, median, reach };
        // Relative to the median, so that geo-referenced centres lose no digits in the sum.
        let usual: Vec<DVec3> =
            finite.iter().filter(|centre| spread.holds(**centre)).map(|centre| *centre - median).collect();
        let mean = usual.iter().sum::<DVec3>() / usual.len().max(1) as f64;
        spread.middle += mean;
        spread.radius = usual.iter().map(|centre| centre.distance(mean)).fold(0.0, f64::max);
        Some(spread)
    }

    /// Whether a centre is no stray.
    pub fn holds(&self, centre: DVec3) -> bool {
        centre.distance(self.median) <= self.reach
    }
}

#[cfg(test)]
mod tests;
