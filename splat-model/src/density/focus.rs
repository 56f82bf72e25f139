//! Growth in a part of the scene.

use burn::tensor::{Bool, Tensor};
use serde::{Deserialize, Serialize};

use crate::capture::blocks::Bounds;

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

    /// `[N]`: whether each of `means`, `[N, 3]`, lies beyond the bounds ([`Bounds::contains`]).
    pub(super) fn beyond(&self, means: &Tensor<2>) -> Tensor<1, Bool> {
        let [count, _] = means.dims();
        let Bounds { box_from_world, low, high } = self.bounds;
        let coordinate = |axis: usize| means.clone().narrow(1, axis, 1).reshape([count]);
        let within = (0..3).flat_map(|axis| {
            let [x, y, z] = box_from_world[axis];
            let local = coordinate(0) * x + coordinate(1) * y + coordinate(2) * z;
            let above = low[axis].map(|low| local.clone().greater_equal_elem(low));
            [above, high[axis].map(|high| local.lower_elem(high))]
        });
        let within = within.flatten().reduce(Tensor::bool_and);
        within.map_or_else(|| coordinate(0).greater_elem(f32::INFINITY), Tensor::bool_not)
    }
}
