//! Statistics of several views: Gaussians in pixels with large errors, and Gaussians that are hardly visible in any view
//! (in the manner of FastGS, Ren et al. 2025, with sums of blending weights instead of counts of pixels, as in Rota Bulò et
//! al. 2024).

use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::gaussians::values_of;
use crate::state::{State, StateError};

/// Options of the agreement of views. Pixels are weighted by the Gaussian's share in their colour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConsistencyConfig {
    /// Number of views that are evaluated between two refinements: 10.
    pub views: usize,
    /// Number of covered pixels with an error above the picture's mean, averaged over the views that show the Gaussian,
    /// from which on it is copied or split.
    pub wrong_px: f32,
    /// Gaussians that cover fewer pixels than this in every evaluated view, and some in at least one, are removed.
    pub shown_px: f32,
}

impl Default for ConsistencyConfig {
    fn default() -> Self {
        Self { views: 10, wrong_px: 2.0, shown_px: 0.1 }
    }
}

impl ConsistencyConfig {
    /// Whether the view of `step` is evaluated, with `every` steps between refinements.
    pub fn asks_at(&self, step: usize, every: usize) -> bool {
        step.is_multiple_of((every / self.views.max(1)).max(1))
    }
}

/// Statistics of the views that were evaluated since the last edit of rows.
#[derive(Debug)]
pub(super) struct Agreement {
    /// `[N]`: covered pixels with a large error, summed over the views.
    wrong: Tensor<1>,
    /// `[N]`: covered pixels in the view with the largest number.
    most: Tensor<1>,
    /// `[N]`: number of views that show the Gaussian.
    views: Tensor<1>,
}

/// What the views say about a Gaussian.
pub(super) struct Agreed {
    /// Whether it covers enough pixels with a large error.
    pub is_wrong: bool,
    /// Whether it is hardly visible. False for one that no view shows.
    pub hardly_shows: bool,
}

impl Agreement {
    /// Adds the statistics of a view, `[N, 2]`: covered pixels, and those of them with a large error.
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

    pub fn read(self, config: &ConsistencyConfig) -> Vec<Agreed> {
        let wrong_px = values_of(self.wrong / self.views.clamp_min(1.0));
        let agreed = |(wrong_px, most_px): (f32, f32)| Agreed {
            is_wrong: wrong_px >= config.wrong_px,
            hardly_shows: most_px > 0.0 && most_px < config.shown_px,
        };
        wrong_px.into_iter().zip(values_of(self.most)).map(agreed).collect()
    }

    pub fn save(&self) -> State {
        let mut state = State::default();
        let entries = [("wrong", &self.wrong), ("most", &self.most), ("views", &self.views)];
        entries.into_iter().for_each(|(name, values)| state.put(name, values.clone()));
        state
    }

    pub fn load(from: &mut State, device: &Device) -> Result<Self, StateError> {
        let wrong: Tensor<1> = from.take("wrong", device)?;
        let mut like = |name: &str| from.take_shaped(name, wrong.dims(), device);
        Ok(Self { most: like("most")?, views: like("views")?, wrong })
    }
}
