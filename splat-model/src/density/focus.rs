//! Growth in a part of the scene.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::capture::blocks::Bounds;
use crate::gaussians::GaussianRows;

/// The part of a scene in which Gaussians are added freely. Beyond it they may take a share of the rows only, so that a block's
/// surroundings are there and remain coarse.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Focus {
    /// The part, world frame relative to the capture's origin.
    pub bounds: Bounds,
    /// Largest share of the cap for Gaussians whose centres lie beyond it.
    pub beyond_share: f64,
}

impl Focus {
    /// The share of the rows for what lies beyond a block's region.
    pub const BEYOND_SHARE: f64 = 0.2;

    /// Focuses on a block's region.
    pub fn on(bounds: Bounds) -> Self {
        Self { bounds, beyond_share: Self::BEYOND_SHARE }
    }

    /// Whether Gaussian `i` lies beyond the bounds.
    pub(super) fn is_beyond(&self, rows: &GaussianRows, i: usize) -> bool {
        !self.bounds.contains(Vec3::from(rows.means[i]).as_dvec3())
    }
}
