//! Kernel of the tally: one unit per Gaussian.

use cubecl::prelude::*;

use crate::gpu::math::{Vec2, positive};

/// Adds one step in place. The first step of a tally, `begins`, reads nothing.
#[cube(launch_unchecked)]
pub(super) fn tally_kernel(
    grad: &[f32],
    sums: &mut [f32],
    counts: &mut [f32],
    per_axis: Vec2,
    count: u32,
    #[comptime] begins: bool,
) {
    let at = ABSOLUTE_POS;
    if at < count as usize {
        let scaled = Vec2::new(grad[2 * at] * per_axis.x, grad[2 * at + 1] * per_axis.y);
        let norm = scaled.dot(scaled).sqrt();
        let shown = select(positive(norm), 1.0f32, 0.0f32);
        if comptime!(begins) {
            sums[at] = norm;
            counts[at] = shown;
        } else {
            sums[at] += norm;
            counts[at] += shown;
        }
    }
}
