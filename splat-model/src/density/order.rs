//! The order of Gaussians in memory: neighbours in space are neighbours in memory, so that the Gaussians of one tile are
//! close together.

use burn::tensor::{Bool, DType, Int, Tensor};
use glam::Vec3;
use rayon::prelude::*;
use splat_op::argsort::argsort;

/// Bits of a coordinate in one key of the order on a device, and keys.
const AXIS_BITS: u32 = 10;

/// The order of the rows `usable`, `[N]`, of `means`, `[N, 3]`, world frame, along the Z-order curve (Morton 1966) through their
/// bounding box, in cells of a millionth of its longest side. Rows of one cell keep their order. Other rows are anywhere among them.
pub(super) fn z_order(means: &Tensor<2>, usable: &Tensor<1, Bool>) -> Tensor<1, Int> {
    let [count, _] = means.dims();
    let unusable = usable.clone().bool_not().reshape([count, 1]).expand([count, 3]);
    // Both bounds in one reduction. An unusable row is as far inside as the device's numbers reach.
    let inside = |values: Tensor<2>| values.mask_fill(unusable.clone(), f32::MAX).swap_dims(0, 1);
    let bounds = Tensor::cat(vec![inside(means.clone()), inside(means.clone().neg())], 0).min_dim(1);
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
    // A cube, so that cells have equal sides. In f64, because the bounding box of finite f32 numbers may be larger than the
    // largest f32.
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
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::gaussians::testing::devices;

    /// The order on the device is that on the host where no two rows share a cell, and leaves out what is not usable.
    #[test]
    fn the_devices_order_is_the_hosts() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut means: Vec<[f32; 3]> = (0..800).map(|_| [(); 3].map(|()| rng.random_range(-2.0..7.0))).collect();
        means[17] = [f32::NAN, f32::INFINITY, -f32::MAX];
        for device in devices() {
            let found = |means: &[[f32; 3]]| -> Vec<u32> {
                let tensor = Tensor::<1>::from_floats(means.as_flattened(), &device).reshape([means.len(), 3]);
                let usable = tensor.clone().abs().lower_elem(1e9).int().sum_dim(1).equal_elem(3).reshape([means.len()]);
                z_order(&tensor, &usable).into_data().iter::<i64>().map(|row| row as u32).collect()
            };
            let order: Vec<u32> = found(&means).into_iter().filter(|row| *row != 17).collect();
            assert_eq!(order, morton_order(&means)[..799]);
            let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 != 0 { 3e38 } else { -3e38 });
            let corners: Vec<[f32; 3]> = [6, 1, 7, 0, 3, 5, 2, 4].map(corner).to_vec();
            // Not usable by the rule of a scene, but the sides do not overflow.
            let tensor = Tensor::<1>::from_floats(corners.as_flattened(), &device).reshape([8, 3]);
            let usable = tensor.clone().narrow(1, 0, 1).reshape([8]).lower_elem(f32::INFINITY);
            let order: Vec<i64> = z_order(&tensor, &usable).into_data().iter().collect();
            assert_eq!(order, [3, 1, 6, 4, 7, 5, 0, 2]);
            assert_eq!(found(&[[2.0; 3]; 4]), [0, 1, 2, 3]);
        }
    }

    #[test]
    fn the_corners_of_a_cube_come_in_the_order_of_their_bits() {
        let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 != 0 { 5.0 } else { -3.0 });
        let means: Vec<[f32; 3]> = [6, 1, 7, 0, 3, 5, 2, 4].map(corner).to_vec();
        let order: Vec<[f32; 3]> = morton_order(&means).into_iter().map(|row| means[row as usize]).collect();
        assert_eq!(order, [0, 1, 2, 3, 4, 5, 6, 7].map(corner));
    }

    #[test]
    fn neighbours_lie_together() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let means: Vec<[f32; 3]> = (0..20_000).map(|_| [(); 3].map(|()| rng.random_range(-2.0..2.0))).collect();
        let mean_step = |order: &[u32]| {
            let step = |pair: &[u32]| Vec3::from(means[pair[0] as usize]).distance(means[pair[1] as usize].into());
            order.windows(2).map(step).sum::<f32>() / means.len() as f32
        };
        let given: Vec<u32> = (0..means.len() as u32).collect();
        assert!(mean_step(&morton_order(&means)) < 0.2 * mean_step(&given));
    }

    #[test]
    fn every_row_comes_once_whatever_it_holds() {
        let odd = [f32::NAN, f32::INFINITY, f32::MAX, -f32::MAX, 0.0, 1e-40, 1.0];
        let means: Vec<[f32; 3]> = (0..343).map(|i| [odd[i % 7], odd[i / 7 % 7], odd[i / 49]]).collect();
        let order = morton_order(&means);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..343).collect::<Vec<u32>>());
        let finite = means.iter().filter(|mean| Vec3::from(**mean).is_finite()).count();
        let is_finite = |row: &u32| Vec3::from(means[*row as usize]).is_finite();
        assert!(order[..finite].iter().all(is_finite) && !order[finite..].iter().any(is_finite));
        assert!(morton_order(&[]).is_empty());
        assert_eq!(morton_order(&[[2.0; 3]; 4]), [0, 1, 2, 3]);
    }
}
