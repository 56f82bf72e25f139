//! Training on reduced photographs first.

use serde::{Deserialize, Serialize};

/// Schedule of the photographs' size. A run that starts with smaller photographs finds coarse shapes earlier and at a
/// fraction of the cost, because the cost of a step grows with its pixels. (Nerfstudio's splatfacto and OpenSplat use fixed
/// numbers of steps; DashGaussian, Chen et al. 2025, the spectrum of the photographs.)
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Resolution {
    /// Initial divisor of the sides: a power of two, 1 for photographs of full size throughout.
    pub coarsest_divisor: usize,
    /// Share of the run after which photographs have their full size. Each smaller size gets an equal part of the earlier steps.
    pub full_from: f64,
}

/// Number of steps with smaller photographs in [`Resolution::within_time`].
const COARSE_STEPS: usize = 1_000;

impl Resolution {
    /// Largest accepted divisor.
    pub const DIVISOR_MAX: usize = 16;

    /// Photographs of full size from the first step. With another divisor, photographs are smaller in the first half of the run.
    pub const FULL: Self = Self { coarsest_divisor: 1, full_from: 0.5 };

    /// The schedule with which a run that has a time instead of a number of steps reaches most, if that time suffices for `steps`: smaller
    /// photographs in the first 1,000 steps, but in at most 0.7 of the run. `docs/ACCURACY.md` holds the measurements.
    pub fn within_time(steps: usize) -> Self {
        let coarsest_divisor = if steps <= COARSE_STEPS { 8 } else { 4 };
        Self { coarsest_divisor, full_from: (COARSE_STEPS as f64 / steps.max(1) as f64).min(0.7) }
    }

    /// Divisor of the sides at `step`, counted from 1, in a run of `steps` steps.
    pub fn divisor_at(&self, step: usize, steps: usize) -> usize {
        let levels = self.coarsest_divisor.max(1).ilog2() as f64;
        let share = (step - 1) as f64 / steps as f64;
        if levels == 0.0 || share >= self.full_from {
            return 1;
        }
        // Number of completed levels.
        let over = (share / self.full_from * levels) as usize;
        (self.coarsest_divisor >> over).max(2)
    }

    /// Whether the values are in range.
    pub fn is_valid(&self) -> bool {
        self.coarsest_divisor.is_power_of_two()
            && self.coarsest_divisor <= Self::DIVISOR_MAX
            && (0.0..=1.0).contains(&self.full_from)
    }
}

impl Default for Resolution {
    fn default() -> Self {
        Self::FULL
    }
}

#[cfg(test)]
mod tests;
