//! Kernels of the composition: a unit per pixel, and for the coefficients a cube per run of pixels and harmonic.

use cubecl::prelude::*;

use crate::gpu::UNITS;
use crate::gpu::reduce::cube_sum;

/// Number of pixels of a cube that sums.
pub(super) const RUN: usize = 64 * UNITS;

/// The sky in a pixel's channel.
#[cube]
fn sky(harmonics: &[f32], coefficients: &[f32], pixel: usize, channel: usize, pixels: u32, count: u32) -> f32 {
    let mut sum = 0.5f32;
    for k in 0..count {
        sum += harmonics[(k * pixels) as usize + pixel] * coefficients[3 * k as usize + channel];
    }
    sum
}

#[cube(launch_unchecked)]
pub(super) fn environment_kernel(
    image: &[f32],
    alpha: &[f32],
    harmonics: &[f32],
    coefficients: &[f32],
    out: &mut [f32],
    pixels: u32,
    count: u32,
) {
    let pixel = ABSOLUTE_POS;
    if pixel < pixels as usize {
        let through = 1.0 - alpha[pixel];
        #[unroll]
        for channel in 0..3usize {
            let at = channel * pixels as usize + pixel;
            out[at] = image[at] + through * sky(harmonics, coefficients, pixel, channel, pixels, count);
        }
    }
}

#[cube(launch_unchecked)]
pub(super) fn alpha_backward_kernel(
    grad: &[f32],
    harmonics: &[f32],
    coefficients: &[f32],
    of_alpha: &mut [f32],
    pixels: u32,
    count: u32,
) {
    let pixel = ABSOLUTE_POS;
    if pixel < pixels as usize {
        let mut sum = 0.0f32;
        #[unroll]
        for channel in 0..3usize {
            let grad = grad[channel * pixels as usize + pixel];
            sum -= grad * sky(harmonics, coefficients, pixel, channel, pixels, count);
        }
        of_alpha[pixel] = sum;
    }
}

/// Writes the sums of a run of pixels to `sums`, `[runs, K, 3]`.
#[cube(launch_unchecked)]
pub(super) fn coefficients_backward_kernel(
    grad: &[f32],
    alpha: &[f32],
    harmonics: &[f32],
    sums: &mut [f32],
    pixels: u32,
    count: u32,
    runs: u32,
) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS < (runs * count) as usize {
        let k = CUBE_POS as u32 % count;
        let first = CUBE_POS as u32 / count * comptime!(RUN as u32);
        let end = min(first + comptime!(RUN as u32), pixels);
        let mut r = 0.0f32;
        let mut g = 0.0f32;
        let mut b = 0.0f32;
        let mut pixel = first + UNIT_POS;
        while pixel < end {
            let at = pixel as usize;
            let weight = harmonics[(k * pixels) as usize + at] * (1.0 - alpha[at]);
            r += weight * grad[at];
            g += weight * grad[pixels as usize + at];
            b += weight * grad[2 * pixels as usize + at];
            pixel += comptime!(UNITS as u32);
        }
        let r = cube_sum(r, &mut shared);
        let g = cube_sum(g, &mut shared);
        let b = cube_sum(b, &mut shared);
        if UNIT_POS == 0 {
            sums[3 * CUBE_POS] = r;
            sums[3 * CUBE_POS + 1] = g;
            sums[3 * CUBE_POS + 2] = b;
        }
    }
}
