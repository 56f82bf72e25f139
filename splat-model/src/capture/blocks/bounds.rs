//! Boxes in a turned frame.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// A box, some of whose sides may be missing. Its lower sides belong to it and its upper sides do not, so that boxes
/// that share a side share no point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bounds {
    /// The axes of the box in the world: the rows of a rotation.
    pub box_from_world: [[f64; 3]; 3],
    /// Lower sides along those axes, scene units.
    pub low: [Option<f64>; 3],
    /// Upper sides.
    pub high: [Option<f64>; 3],
}

impl Bounds {
    /// The whole space, with these axes.
    pub fn everything(box_from_world: DMat3) -> Self {
        Self { box_from_world: box_from_world.transpose().to_cols_array_2d(), low: [None; 3], high: [None; 3] }
    }

    /// A position of the world along the axes of the box.
    pub fn local(&self, position_world: DVec3) -> DVec3 {
        DVec3::from(self.box_from_world.map(|axis| DVec3::from(axis).dot(position_world)))
    }

    /// Whether the box holds a position of the world. It holds no position with a NaN.
    pub fn contains(&self, position_world: DVec3) -> bool {
        let local = self.local(position_world).to_array();
        (0..3).all(|axis| {
            let above = self.low[axis].is_none_or(|low| local[axis] >= low);
            let below = self.high[axis].is_none_or(|high| local[axis] < high);
            above && below && !local[axis].is_nan()
        })
    }

    /// The box with its sides moved outwards by these lengths, scene units.
    pub fn grown(self, by: [f64; 3]) -> Self {
        Self {
            low: std::array::from_fn(|axis| self.low[axis].map(|low| low - by[axis])),
            high: std::array::from_fn(|axis| self.high[axis].map(|high| high + by[axis])),
            ..self
        }
    }

    /// The two parts on the sides of a plane across an axis.
    pub(super) fn cut(self, axis: usize, at: f64) -> [Self; 2] {
        let (mut below, mut above) = (self, self);
        (below.high[axis], above.low[axis]) = (Some(at), Some(at));
        [below, above]
    }
}
