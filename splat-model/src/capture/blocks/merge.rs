//! What a block keeps of its trained scene.

use glam::{DQuat, DVec3, Vec3};

use super::Bounds;
use crate::gaussians::GaussianRows;

/// Share of a Gaussian below which none of it is kept, and above one minus which all of it is.
const NEGLIGIBLE: f64 = 0.02;

/// Slope of the logistic function that stands for the normal distribution's: the two differ by at most 0.01 (Bowling et al. 2009).
const LOGISTIC: f64 = 1.702;

/// Appends to `kept` what `cell` keeps of a block's rows: the Gaussians in it that can be rendered.
///
/// A Gaussian that reaches across a border belongs to each side by the share of its mass there, `w`, and its opacity `α` becomes
/// `1 − (1 − α)^w`, a share `w` of its optical depth. Where two blocks have the same Gaussian, the parts add up to the whole. Had each block to keep or drop such
/// Gaussians by their centres, a wall of a few large ones would have a hole at the border, or be there twice.
///
/// # Panics
/// If the rows do not fit together, or `kept` has another degree.
pub fn keep(cell: &Bounds, rows: &GaussianRows, kept: &mut GaussianRows) {
    assert_eq!(rows.sh_degree, kept.sh_degree, "rows of one degree");
    for row in 0..rows.len() {
        // A Gaussian that cannot be rendered has no share.
        let share = if rows.is_usable(row) { share_of(cell, rows, row) } else { 0.0 };
        if share < NEGLIGIBLE {
            continue;
        }
        kept.push(rows, row);
        if share < 1.0 - NEGLIGIBLE {
            let last = kept.len() - 1;
            kept.logit_opacities[last] = thinned(rows.logit_opacities[row], share);
        }
    }
}

/// The share of a Gaussian's mass in a box, 0 to 1. The shares of boxes that divide space along one axis add up to one.
fn share_of(cell: &Bounds, rows: &GaussianRows, row: usize) -> f64 {
    let mean = cell.local(Vec3::from(rows.means[row]).as_dvec3());
    let [w, x, y, z] = rows.rotations[row].map(f64::from);
    let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
    let scales = rows.log_scales[row].map(|log| f64::from(log).exp());
    let mut share = 1.0;
    for axis in 0..3 {
        let direction = rotation.inverse() * DVec3::from(cell.box_from_world[axis]);
        let deviation = (direction * DVec3::from(scales)).length().max(f64::MIN_POSITIVE);
        // The share below a side.
        let below = |side: f64| 1.0 / (1.0 + (-LOGISTIC * (side - mean[axis]) / deviation).exp());
        share *= cell.high[axis].map_or(1.0, below) - cell.low[axis].map_or(0.0, below);
    }
    share
}

/// The logit of an opacity whose optical depth is a share of the given one's: `ln(exp(w ln(1 + eˡ)) − 1)`.
fn thinned(logit: f32, share: f64) -> f32 {
    let logit = f64::from(logit);
    // ln(1 + eˡ), which is −ln(1 − α), without overflow.
    let depth = share * (logit.max(0.0) + (-logit.abs()).exp().ln_1p());
    // For a large depth the logarithm is the depth itself.
    (depth + (-(-depth).exp_m1()).ln()) as f32
}

#[cfg(test)]
mod tests;
