//! Kernels of the colour map: a unit per pixel, and for the gradient of the map a cube per run of pixels.

use cubecl::prelude::*;

use super::MAP;
use crate::gpu::UNITS;
use crate::gpu::reduce::cube_sum;

/// Number of pixels of a cube that sums.
pub(super) const RUN: usize = 64 * UNITS;

#[cube(launch_unchecked)]
pub(super) fn colour_map_kernel(image: &[f32], map: &[f32], out: &mut [f32], pixels: u32) {
    let pixel = ABSOLUTE_POS;
    if pixel < pixels as usize {
        let (r, g, b) = (image[pixel], image[pixels as usize + pixel], image[2 * pixels as usize + pixel]);
        #[unroll]
        for row in 0..3usize {
            let at = 4 * row;
            out[row * pixels as usize + pixel] = map[at + 3] + map[at] * r + map[at + 1] * g + map[at + 2] * b;
        }
    }
}

#[cube(launch_unchecked)]
pub(super) fn image_backward_kernel(map: &[f32], grad: &[f32], of_image: &mut [f32], pixels: u32) {
    let pixel = ABSOLUTE_POS;
    if pixel < pixels as usize {
        let (r, g, b) = (grad[pixel], grad[pixels as usize + pixel], grad[2 * pixels as usize + pixel]);
        #[unroll]
        for channel in 0..3usize {
            of_image[channel * pixels as usize + pixel] =
                map[channel] * r + map[4 + channel] * g + map[8 + channel] * b;
        }
    }
}

/// Writes the sums of a run of pixels to `sums`, `[runs, 12]`.
#[cube(launch_unchecked)]
pub(super) fn map_backward_kernel(image: &[f32], grad: &[f32], sums: &mut [f32], pixels: u32, runs: u32) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS < runs as usize {
        let first = CUBE_POS as u32 * comptime!(RUN as u32);
        let end = min(first + comptime!(RUN as u32), pixels);
        #[unroll]
        for entry in 0..comptime!(MAP) {
            let mut own = 0.0f32;
            let mut pixel = first + UNIT_POS;
            while pixel < end {
                let grad = grad[comptime!(entry / 4) * pixels as usize + pixel as usize];
                if comptime!(entry % 4 == 3) {
                    own += grad;
                } else {
                    own += grad * image[comptime!(entry % 4) * pixels as usize + pixel as usize];
                }
                pixel += comptime!(UNITS as u32);
            }
            let total = cube_sum(own, &mut shared);
            if UNIT_POS == 0 {
                sums[CUBE_POS * comptime!(MAP) + entry] = total;
            }
        }
    }
}
