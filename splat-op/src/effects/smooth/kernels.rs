//! Kernels of the convolution: one unit per standard deviation, or per Gaussian.

use cubecl::prelude::*;

use crate::gpu::math::Vec3;

#[cube]
fn hypotenuse(a: f32, b: f32) -> f32 {
    Vec3::new(a, b, 0.0).length()
}

/// The inverses of a Gaussian's new standard deviations.
#[cube]
fn inverses(scales: Vec3, width: f32) -> Vec3 {
    Vec3::new(1.0 / hypotenuse(scales.x, width), 1.0 / hypotenuse(scales.y, width), 1.0 / hypotenuse(scales.z, width))
}

#[cube(launch_unchecked)]
pub(super) fn smoothed_scales_kernel(scales: &[f32], widths: &[f32], out: &mut [f32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        out[ABSOLUTE_POS] = hypotenuse(scales[ABSOLUTE_POS], widths[ABSOLUTE_POS / 3]);
    }
}

#[cube(launch_unchecked)]
pub(super) fn smoothed_opacities_kernel(
    scales: &[f32],
    opacities: &[f32],
    widths: &[f32],
    out: &mut [f32],
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let scales = Vec3::load(scales, 3 * ABSOLUTE_POS);
        let shares = scales.by_axis(inverses(scales, widths[ABSOLUTE_POS]));
        out[ABSOLUTE_POS] = opacities[ABSOLUTE_POS] * (shares.x * shares.y * shares.z);
    }
}

#[cube(launch_unchecked)]
pub(super) fn smoothed_opacities_backward_kernel(
    scales: &[f32],
    opacities: &[f32],
    widths: &[f32],
    grad: &[f32],
    of_scales: &mut [f32],
    of_opacities: &mut [f32],
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let scales = Vec3::load(scales, 3 * ABSOLUTE_POS);
        let inverse = inverses(scales, widths[ABSOLUTE_POS]);
        let shares = scales.by_axis(inverse);
        let added = inverse.times(widths[ABSOLUTE_POS]);
        let grad = grad[ABSOLUTE_POS];
        let others = Vec3::new(shares.y * shares.z, shares.x * shares.z, shares.x * shares.y);
        let slopes = others.by_axis(added.by_axis(added).by_axis(inverse));
        slopes.times(grad * opacities[ABSOLUTE_POS]).store(of_scales, 3 * ABSOLUTE_POS);
        of_opacities[ABSOLUTE_POS] = grad * (shares.x * shares.y * shares.z);
    }
}
