//! Gaussians beyond the reach of the grid.
//!
//! All centres share a grid of 24 bits, so one Gaussian far away makes the grid of all others coarse. A Gaussian that is more than
//! 512 times the scene's width away is therefore moved to the border of a finer grid, along the line from the scene's middle, and
//! shrunk with its distance. Seen from the middle, it looks the same; from half a width beside it, its direction changes by a
//! thousandth of a radian at most.

use super::pack::{MOST, farthest, fraction};
use crate::cleanup::Bulk;
use crate::gaussians::GaussianRows;

/// Room around the scene, in multiples of the width of its bulk. A step of the grid is then 2⁻¹³ to 2⁻¹⁴ of the width.
const ROOM: f64 = 512.0;

/// Moves the Gaussians that would make the grid too coarse. Returns their number.
pub(in crate::formats) fn bring_within_reach(rows: &mut GaussianRows) -> usize {
    let Some(bulk) = Bulk::of(&rows.means).filter(|bulk| bulk.width > 0.0) else { return 0 };
    let ordinary = farthest(rows.means.iter().filter(|mean| bulk.holds(mean)));
    let bits = fraction(ordinary + ROOM * bulk.width);
    if fraction(farthest(&rows.means)) >= bits {
        return 0;
    }
    let border = MOST / f64::from(1_u32 << bits);
    let mut moved = 0;
    for (mean, log_scales) in rows.means.iter_mut().zip(&mut rows.log_scales) {
        // The share of the way from the middle to the centre at which the border is met.
        let share = (0..3).fold(1.0_f64, |share, axis| {
            let way = f64::from(mean[axis]) - bulk.middle[axis];
            share.min((border.copysign(way) - bulk.middle[axis]) / way)
        });
        if share < 1.0 {
            *mean = [0, 1, 2].map(|axis| {
                let middle = bulk.middle[axis];
                (middle + share * (f64::from(mean[axis]) - middle)).clamp(-border, border) as f32
            });
            *log_scales = log_scales.map(|log| (f64::from(log) + share.ln()) as f32);
            moved += 1;
        }
    }
    moved
}
