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
