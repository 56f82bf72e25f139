//! The two Gaussians that take the place of one whose gradient is large.

use glam::{DQuat, Quat, Vec3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::gaussians::{self, GaussianRows};

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
const SPLIT_SHRINK: f32 = 1.6;

/// Length of a half along the axis that is cut, distance of its centre from the old one, both in standard deviations of the
/// whole, and its opacity relative to the whole's. The alpha of two such halves differs from the whole's by 10% (opacity 0.1)
/// to 17% (opacity 0.99), as the root of the mean square along the axis relative to the whole's; two parts of a split differ
/// by 72% to 82%.
const HALF_LENGTH: f32 = 0.6;
const HALF_OFFSET: f32 = 0.6;
const HALF_OPACITY: f64 = 0.8;

/// Appends two smaller copies of row `i` at positions drawn from the Gaussian's own distribution.
pub(super) fn push_parts(to: &mut GaussianRows, from: &GaussianRows, i: usize, rng: &mut dyn Rng) {
    let scale = Vec3::from(from.log_scales[i]).exp();
    for _ in 0..2 {
        let drawn: [f32; 3] = std::array::from_fn(|_| StandardNormal.sample(rng));
        push_at(to, from, i, scale * Vec3::from(drawn));
        let last = to.len() - 1;
        to.log_scales[last] = from.log_scales[i].map(|log| log - SPLIT_SHRINK.ln());
    }
}

/// Appends the two halves of row `i`.
pub(super) fn push_halves(to: &mut GaussianRows, from: &GaussianRows, i: usize) {
    let logs = from.log_scales[i];
    let longest = (1..3).fold(0, |longest, axis| if logs[axis] > logs[longest] { axis } else { longest });
    let opacity = HALF_OPACITY * gaussians::sigmoid(from.logit_opacities[i]);
    for side in [-HALF_OFFSET, HALF_OFFSET] {
        push_at(to, from, i, Vec3::AXES[longest] * side * logs[longest].exp());
        let last = to.len() - 1;
        to.log_scales[last][longest] = logs[longest] + HALF_LENGTH.ln();
        to.logit_opacities[last] = (opacity / (1.0 - opacity)).ln() as f32;
    }
}

/// Appends a copy of row `i`, displaced by `offset` along the Gaussian's axes.
fn push_at(to: &mut GaussianRows, from: &GaussianRows, i: usize, offset: Vec3) {
    to.push(from, i);
    let last = to.len() - 1;
    to.means[last] = (Vec3::from(from.means[i]) + world_from_gaussian(from, i) * offset).to_array();
}

fn world_from_gaussian(rows: &GaussianRows, i: usize) -> Quat {
    // In f64, because quaternions may have any length, whose square may overflow or underflow in f32.
    let [w, x, y, z] = rows.rotations[i].map(f64::from);
    DQuat::from_xyzw(x, y, z, w).normalize().as_quat()
}

#[cfg(test)]
mod tests;
