//! Kernels of the composition: a unit per pixel, and for the coefficients a cube per run of pixels and harmonic. The degree is a compile-time constant.

use cubecl::prelude::*;

use crate::gpu::{UNITS, Vec3, cube_sum};
use crate::sh::coefficients_of;
use crate::sh::forward::basis;

/// Number of pixels of a cube that sums.
pub(super) const RUN: usize = 64 * UNITS;

/// The values of the harmonics in a pixel's direction.
#[cube]
fn harmonics(directions: &[f32], pixel: usize, pixels: u32, #[comptime] degree: usize) -> Sequence<f32> {
    let plane = pixels as usize;
    basis(Vec3::new(directions[pixel], directions[plane + pixel], directions[2 * plane + pixel]), degree)
}

/// The sky in a channel.
#[cube]
fn sky(harmonics: &Sequence<f32>, coefficients: &[f32], channel: usize, #[comptime] degree: usize) -> f32 {
    let mut sum = 0.5f32;
    #[unroll]
    for k in 0..comptime!(coefficients_of(degree)) {
        sum += harmonics[k] * coefficients[3 * k + channel];
    }
    sum
}

#[cube(launch_unchecked)]
pub(super) fn environment_kernel(
    image: &[f32],
    alpha: &[f32],
    directions: &[f32],
    coefficients: &[f32],
    out: &mut [f32],
    pixels: u32,
    #[comptime] degree: usize,
) {
    let pixel = ABSOLUTE_POS;
    if pixel < pixels as usize {
        let through = 1.0 - alpha[pixel];
        let harmonics = harmonics(directions, pixel, pixels, degree);
        #[unroll]
        for channel in 0..3usize {
            let at = channel * pixels as usize + pixel;
            out[at] = image[at] + through * sky(&harmonics, coefficients, channel, degree);
        }
    }
}

#[cube(launch_unchecked)]
pub(super) fn alpha_backward_kernel(
    grad: &[f32],
    directions: &[f32],
    coefficients: &[f32],
    of_alpha: &mut [f32],
    pixels: u32,
    #[comptime] degree: usize,
) {
    let pixel = ABSOLUTE_POS;
    if pixel < pixels as usize {
        let harmonics = harmonics(directions, pixel, pixels, degree);
        let mut sum = 0.0f32;
        #[unroll]
        for channel in 0..3usize {
            let grad = grad[channel * pixels as usize + pixel];
            sum -= grad * sky(&harmonics, coefficients, channel, degree);
        }
        of_alpha[pixel] = sum;
    }
}

/// Writes the sums of a run of pixels to `sums`, `[runs, K, 3]`: a cube per run and harmonic, because the sums of all would take more
/// registers than a unit has.
#[cube(launch_unchecked)]
pub(super) fn coefficients_backward_kernel(
    grad: &[f32],
    alpha: &[f32],
    directions: &[f32],
    sums: &mut [f32],
    pixels: u32,
    runs: u32,
    #[comptime] degree: usize,
) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    let count = comptime!(coefficients_of(degree) as u32);
    if CUBE_POS < (runs * count) as usize {
        let own = CUBE_POS as u32 % count;
        let first = CUBE_POS as u32 / count * comptime!(RUN as u32);
        let end = min(first + comptime!(RUN as u32), pixels);
        let mut r = 0.0f32;
        let mut g = 0.0f32;
        let mut b = 0.0f32;
        let mut pixel = first + UNIT_POS;
        while pixel < end {
            let at = pixel as usize;
            let harmonics = harmonics(directions, at, pixels, degree);
            let mut weight = 0.0f32;
            #[unroll]
            for k in 0..comptime!(coefficients_of(degree)) {
                if own == comptime!(k as u32) {
                    weight = harmonics[k];
                }
            }
            weight *= 1.0 - alpha[at];
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
