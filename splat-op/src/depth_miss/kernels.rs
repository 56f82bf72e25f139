//! Kernels of the miss: a unit per sample, whose sums over a cube are added in a fixed order. The first sample of a pixel writes the
//! gradients of all.

use cubecl::prelude::*;

use super::COVERED;
use crate::gpu::UNITS;
use crate::gpu::reduce::cube_sum;

/// Returns whether a sample counts, `e` and `α z`, and `D/α`.
#[cube]
fn sample(depth: &[f32], alpha: &[f32], known: f32, pixel: u32, plane: u32) -> (bool, f32, f32, f32) {
    // A pixel below zero is one beyond the last.
    let inside = pixel < plane;
    let at = select(inside, pixel, 0u32) as usize;
    let counts = inside && alpha[at] >= comptime!(COVERED as f32);
    let covered = select(counts, alpha[at], 1.0);
    let divisor = covered * known;
    (counts, depth[at] / divisor - 1.0, divisor, depth[at] / covered)
}

/// Writes the sums of each cube's samples to `sums`, `[cubes, 2]`: of those that count, their number and the sum of `|e|`.
#[cube(launch_unchecked)]
pub(super) fn sums_kernel(
    depth: &[f32],
    alpha: &[f32],
    known: &[f32],
    pixels: &[u32],
    sums: &mut [f32],
    plane: u32,
    count: u32,
    cubes: u32,
) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS < cubes as usize {
        let i = CUBE_POS * comptime!(UNITS) + UNIT_POS as usize;
        let mut one = 0.0f32;
        let mut miss = 0.0f32;
        if i < count as usize {
            let (counts, error, _, _) = sample(depth, alpha, known[i], pixels[i], plane);
            if counts {
                one = 1.0;
                miss = error.abs();
            }
        }
        let number = cube_sum(one, &mut shared);
        let miss = cube_sum(miss, &mut shared);
        if UNIT_POS == 0 {
            sums[2 * CUBE_POS] = number;
            sums[2 * CUBE_POS + 1] = miss;
        }
    }
}

/// Writes the mean of the sums `totals`, `[2]`.
#[cube(launch_unchecked)]
pub(super) fn mean_kernel(totals: &[f32], out: &mut [f32]) {
    if ABSOLUTE_POS == 0 {
        out[0] = totals[1] / max(totals[0], 1.0);
    }
}

/// Writes the gradients of the pixels with samples; the others are zero already.
#[cube(launch_unchecked)]
pub(super) fn backward_kernel(
    depth: &[f32],
    alpha: &[f32],
    known: &[f32],
    pixels: &[u32],
    totals: &[f32],
    grad: &[f32],
    of_depth: &mut [f32],
    of_alpha: &mut [f32],
    plane: u32,
    count: u32,
) {
    let i = ABSOLUTE_POS;
    if i < count as usize {
        let pixel = pixels[i];
        let before = pixels[select(i == 0, i, i - 1)];
        if (i == 0 || before != pixel) && pixel < plane {
            let share = grad[0] / max(totals[0], 1.0);
            let mut along_depth = 0.0f32;
            let mut along_alpha = 0.0f32;
            let mut j = i;
            let mut left = 1u32;
            while left == 1u32 {
                let (counts, error, divisor, seen) = sample(depth, alpha, known[j], pixel, plane);
                let sign = select(error > 0.0, 1.0f32, select(error < 0.0, -1.0f32, 0.0f32));
                let slope = select(counts, share * sign / divisor, 0.0f32);
                along_depth += slope;
                along_alpha -= slope * seen;
                j += 1;
                let next = select(j < count as usize, j, i);
                left = select(j < count as usize && pixels[next] == pixel, 1u32, 0u32);
            }
            of_depth[pixel as usize] = along_depth;
            of_alpha[pixel as usize] = along_alpha;
        }
    }
}
