//! The two Gaussians that take the place of one whose gradient is large.

use burn::tensor::{Int, Tensor, activation};
use serde::{Deserialize, Serialize};

use crate::density::noise::normal;
use crate::density::rotate::{rotated, unit};
use crate::gaussians::Gaussians;

/// How one Gaussian becomes two.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Division {
    /// A small Gaussian is copied. A large one is replaced by two smaller ones at positions drawn from its own distribution
    /// (Kerbl et al. 2023, section 5.2).
    CloneOrSplit,
    /// Every Gaussian is replaced by two halves, side by side along its longest axis (after Improved-GS, Deng et al. 2025).
    /// Nothing is drawn, and the picture hardly changes.
    LongAxis,
}

/// Factor by which the parts of a split Gaussian are smaller (Kerbl et al. 2023, section 5.2).
const SPLIT_SHRINK: f64 = 1.6;

/// Length of a half along the axis that is cut, distance of its centre from the old one, both in standard deviations of the whole, and its
/// opacity relative to the whole's. The alpha of two such halves differs from the whole's by 10% (opacity 0.1) to 17% (opacity 0.99), as
/// the root of the mean square along the axis relative to the whole's; two parts of a split differ by 72% to 82%.
const HALF_LENGTH: f64 = 0.6;
const HALF_OFFSET: f64 = 0.6;
const HALF_OPACITY: f64 = 0.8;

/// Centres, logarithms of the standard deviations, and logits of the opacities of new rows.
pub(super) struct Divided {
    pub means: Tensor<2>,
    pub log_scales: Tensor<2>,
    pub logit_opacities: Tensor<1>,
}

/// The rows `of`, `[K]`, of a scene without autodiff.
struct Whole {
    means: Tensor<2>,
    log_scales: Tensor<2>,
    logit_opacities: Tensor<1>,
    rotations: Tensor<2>,
}

impl Whole {
    fn of(scene: &Gaussians, rows: &Tensor<1, Int>) -> Self {
        let part = |values: Tensor<2>| values.select(0, rows.clone());
        Self {
            means: part(scene.means()),
            log_scales: part(scene.log_scales()),
            logit_opacities: scene.logit_opacities().select(0, rows.clone()),
            rotations: part(scene.rotations()),
        }
    }

    /// The centres displaced along the Gaussians' axes by `offset`, `[K, 3]`.
    fn displaced(&self, offset: Tensor<2>) -> Tensor<2> {
        let (w, axis) = unit(self.rotations.clone());
        self.means.clone() + rotated(offset, w, axis)
    }
}

/// Smaller copies of `rows`, `[K]`, of a scene without autodiff, at positions drawn from each Gaussian's own distribution.
pub(super) fn parts(scene: &Gaussians, rows: &Tensor<1, Int>, seed: u64) -> Divided {
    let whole = Whole::of(scene, rows);
    let drawn = normal(seed, rows.dims()[0], &rows.device());
    let means = whole.displaced(drawn.cast(whole.means.dtype()) * whole.log_scales.clone().exp());
    Divided { means, log_scales: whole.log_scales - SPLIT_SHRINK.ln(), logit_opacities: whole.logit_opacities }
}

/// The halves of `rows`, `[K]`, of a scene without autodiff: all on one side of the wholes, then all on the other.
pub(super) fn halves(scene: &Gaussians, rows: &Tensor<1, Int>) -> Divided {
    let whole = Whole::of(scene, rows);
    let longest = longest_axis(whole.log_scales.clone());
    let offset = whole.displaced(longest.clone() * whole.log_scales.clone().exp() * HALF_OFFSET) - whole.means.clone();
    let means = Tensor::cat(vec![whole.means.clone() - offset.clone(), whole.means + offset], 0);
    let log_scales = whole.log_scales + longest * HALF_LENGTH.ln();
    let opacities = activation::sigmoid(whole.logit_opacities) * HALF_OPACITY;
    let logit_opacities = opacities.clone().log() - opacities.neg().log1p();
    let twice = |values: Tensor<2>| Tensor::cat(vec![values.clone(), values], 0);
    Divided {
        means,
        log_scales: twice(log_scales),
        logit_opacities: Tensor::cat(vec![logit_opacities.clone(), logit_opacities], 0),
    }
}

/// `[K, 3]`: 1 at the largest of three numbers, the first of equal ones, and 0 elsewhere.
fn longest_axis(logs: Tensor<2>) -> Tensor<2> {
    let axis = |axis: usize| logs.clone().narrow(1, axis, 1);
    let (x, y, z) = (axis(0), axis(1), axis(2));
    let first = x.clone().greater_equal(y.clone()).bool_and(x.greater_equal(z.clone()));
    let second = y.greater_equal(z).bool_and(first.clone().bool_not());
    let third = first.clone().bool_or(second.clone()).bool_not();
    Tensor::cat([first, second, third].map(|axis| axis.float().cast(logs.dtype())).to_vec(), 1)
}

#[cfg(test)]
mod tests;
