//! Which Gaussians several views agree on: where pictures are still wrong, and what hardly shows in any of them (in the manner
//! of FastGS, Ren et al. 2025, whose counts of pixels are here sums of blending weights, as in Rota Bulò et al. 2024).

use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::gaussians::values_of;
use crate::state::{State, StateError};

/// How much views have to agree. What is counted are pixels, each by the Gaussian's share in its colour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConsistencyConfig {
    /// Views that are asked between two refinements: 10.
    pub views: usize,
    /// Gaussians are copied or split only if in the mean of the views that show them they cover so many pixels that are wrong by
    /// more than is usual in the picture.
    pub wrong_px: f32,
    /// Gaussians that cover less than this in every view that was asked, and something in one, are removed.
    pub shown_px: f32,
}

impl Default for ConsistencyConfig {
    fn default() -> Self {
        Self { views: 10, wrong_px: 2.0, shown_px: 0.1 }
    }
}

impl ConsistencyConfig {
    /// Whether the view of `step` is asked, of `every` steps between refinements.
    pub fn asks_at(&self, step: usize, every: usize) -> bool {
        step.is_multiple_of((every / self.views.max(1)).max(1))
    }
}

/// What the views that were asked have said since the last edit of rows.
#[derive(Debug)]
pub(super) struct Agreement {
    /// `[N]`: pixels covered that were wrong, of all views.
    wrong: Tensor<1>,
    /// `[N]`: pixels covered in the view that shows most of it.
    most: Tensor<1>,
    /// `[N]`: views that show it.
    views: Tensor<1>,
}

/// The same on the host.
pub(super) struct Agreed {
    wrong_px: Vec<f32>,
    most_px: Vec<f32>,
}

impl Agreement {
    /// Adds what a view says, `[N, 2]`: pixels covered, and those of them that are wrong.
    pub fn with(before: Option<Self>, covered: Tensor<2>) -> Self {
        let column = |i: usize| covered.clone().narrow(1, i, 1).squeeze_dim::<1>(1);
        let (shown, wrong) = (column(0), column(1));
        let views = shown.clone().greater_elem(0.0).float();
        match before {
            None => Self { wrong, most: shown, views },
            Some(before) => {
                Self { wrong: before.wrong + wrong, most: before.most.max_pair(shown), views: before.views + views }
            }
        }
    }

    pub fn read(self) -> Agreed {
        let wrong_px = values_of(self.wrong / self.views.clamp_min(1.0));
        Agreed { wrong_px, most_px: values_of(self.most) }
    }

    pub fn save(&self, to: &mut State) {
        to.put("wrong", self.wrong.clone());
        to.put("most", self.most.clone());
        to.put("views", self.views.clone());
    }

    pub fn load(from: &mut State, device: &Device) -> Result<Self, StateError> {
        let wrong: Tensor<1> = from.take("wrong", device)?;
        let shape = wrong.dims();
        Ok(Self {
            wrong,
            most: from.take_shaped("most", shape, device)?,
            views: from.take_shaped("views", shape, device)?,
        })
    }
}

impl Agreed {
    /// Whether Gaussian `i` is where pictures are wrong.
    pub fn is_wrong(&self, i: usize, config: &ConsistencyConfig) -> bool {
        self.wrong_px[i] >= config.wrong_px
    }

    /// Whether it hardly shows. One that no view shows is not known to.
    pub fn hardly_shows(&self, i: usize, config: &ConsistencyConfig) -> bool {
        self.most_px[i] > 0.0 && self.most_px[i] < config.shown_px
    }
}
