//! The order of Gaussians in memory: neighbours in space are neighbours in memory, so that the Gaussians of one tile are close together.

use burn::tensor::{Bool, DType, Int, Tensor};
use glam::Vec3;
use rayon::prelude::*;
use splat_op::argsort::argsort;

use crate::fold::folded;

/// Bits of a coordinate in one key of the order on a device, and keys.
const AXIS_BITS: u32 = 10;

/// The order of the rows `usable`, `[N]`, of `means`, `[N, 3]`, world frame, along the Z-order curve (Morton 1966) through their
/// bounding box, in cells of a millionth of its longest side. Rows of one cell keep their order. Other rows are anywhere among them.
pub(super) fn z_order(means: &Tensor<2>, usable: &Tensor<1, Bool>) -> Tensor<1, Int> {
    let [count, _] = means.dims();
    let unusable = usable.clone().bool_not().reshape([count, 1]).expand([count, 3]);
    // Both bounds in one reduction. An unusable row is as far inside as the device's numbers reach.
    let inside = |values: Tensor<2>| values.mask_fill(unusable.clone(), f32::MAX).swap_dims(0, 1);
    let sides = Tensor::cat(vec![inside(means.clone()), inside(means.clone().neg())], 0);
    let bounds = folded(sides, f32::MAX.into()).min_dim(2).min_dim(1).reshape([6, 1]);
    let low = bounds.clone().narrow(0, 0, 3);
    // Halves, because the bounding box of finite f32 numbers may be larger than the largest f32.
    let side = (bounds.narrow(0, 3, 3).neg() * 0.5 - low.clone() * 0.5).max_dim(0);
    let cells = f64::from(1 << (2 * AXIS_BITS)) - 1.0;
    let half_places = (means.clone() * 0.5 - (low * 0.5).swap_dims(0, 1)) / side.clamp_min(f32::MIN_POSITIVE);
    let places = (half_places * cells).clamp(0.0, cells).mask_fill(unusable, 0.0).floor().int().cast(DType::I32);
    let coarse = interleaved(places.clone().bitwise_right_shift_scalar(AXIS_BITS as i32));
    let fine = interleaved(places.bitwise_and_scalar((1 << AXIS_BITS) - 1));
    let by_fine = argsort(fine, 3 * AXIS_BITS);
    by_fine.clone().select(0, argsort(coarse.select(0, by_fine), 3 * AXIS_BITS))
}

/// `[N]`: the bits of three numbers of ten bits, `[N, 3]`, in turn.
fn interleaved(places: Tensor<2, Int>) -> Tensor<1, Int> {
    let [count, _] = places.dims();
    let spread = [(16, 0x0300_00ff), (8, 0x0300_f00f), (4, 0x030c_30c3), (2, 0x0924_9249)];
    let spread = spread.into_iter().fold(places, |bits, (by, mask): (i32, i32)| {
        // Without the bits that the shift would lose, because a CPU device refuses them.
        let shifted = bits.clone().bitwise_and_scalar(i32::MAX >> by).bitwise_left_shift_scalar(by);
        bits.bitwise_or(shifted).bitwise_and_scalar(mask)
    });
    let axis = |axis: usize| spread.clone().narrow(1, axis, 1).reshape([count]);
    axis(0) + axis(1) * 2 + axis(2) * 4
}

/// The order of `means`, world frame, along the Z-order curve (Morton 1966) through the bounding box of all finite rows.
/// Non-finite rows come last. Rows of one cell keep their order.
pub fn morton_order(means: &[[f32; 3]]) -> Vec<u32> {
    let points = || means.iter().map(|mean| Vec3::from(*mean)).filter(|mean| mean.is_finite());
    let low = points().fold(Vec3::INFINITY, Vec3::min).as_dvec3();
    let high = points().fold(Vec3::NEG_INFINITY, Vec3::max).as_dvec3();
    // A cube, so that cells have equal sides. In f64, because the bounding box of finite f32 numbers may be larger than the largest f32.
    let side = (high - low).max_element();
    let per_unit = if side > 0.0 { f64::from(u32::MAX) / side } else { 0.0 };
    let key = |mean: &[f32; 3]| {
        let mean = Vec3::from(*mean);
        // Casts saturate. A key of three 32-bit coordinates has 96 bits.
        mean.is_finite().then(|| zorder::index_of(((mean.as_dvec3() - low) * per_unit).to_array().map(|at| at as u32)))
    };
    let mut rows: Vec<(u128, u32)> = means
        .par_iter()
        .enumerate()
        .map(|(row, mean)| (key(mean).unwrap_or(u128::MAX), u32::try_from(row).expect("rows are counted in u32")))
        .collect();
    rows.par_sort_unstable();
    rows.into_iter().map(|(_, row)| row).collect()
}

#[cfg(test)]
mod tests;
