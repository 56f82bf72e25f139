//! What tests of lists and of their readers share.

use super::{Cut, IntersectionLists};

/// Tests keep boxes.
impl<M> From<f64> for Cut<M> {
    fn from(alpha_min: f64) -> Self {
        Self { alpha_min, boxes: true, mask: None }
    }
}

impl IntersectionLists {
    /// Returns the number of Gaussians that each tile lists.
    pub fn counts(&self) -> Vec<u32> {
        self.tile_start.windows(2).map(|ends| (ends[1] - ends[0]) as u32).collect()
    }
}
