use burn::tensor::{Tensor, TensorData};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::add;
use crate::gaussians::testing::devices;

#[test]
fn three_steps_add_up_on_every_device() {
    for count in [1, 255, 5_000] {
        let mut random = ChaCha8Rng::seed_from_u64(count as u64);
        let mut steps: Vec<Vec<f32>> =
            (0..3).map(|_| (0..2 * count).map(|_| random.random_range(-1e-3..1e-3)).collect()).collect();
        steps.iter_mut().for_each(|step| step.chunks_exact_mut(14).for_each(|row| row[..2].fill(0.0)));
        for device in devices() {
            let mut tally = None;
            for step in &steps {
                let grad = Tensor::<2>::from_data(TensorData::new(step.clone(), [count, 2]), &device);
                tally = Some(add(tally, grad, [48.0, 32.0]));
            }
            let tally = tally.expect("three steps");
            let [sums, counts] = [tally.sums, tally.counts].map(|t| t.into_data().try_to_vec::<f32>().expect("f32"));
            for i in 0..count {
                let norm = |step: &Vec<f32>| (f64::from(step[2 * i]) * 48.0).hypot(f64::from(step[2 * i + 1]) * 32.0);
                let norms: Vec<f64> = steps.iter().map(norm).collect();
                let (sum, shown) = (norms.iter().sum::<f64>(), norms.iter().filter(|norm| **norm > 0.0).count());
                assert!((f64::from(sums[i]) - sum).abs() <= 1e-6 * sum, "{count}, {device:?}, {i}: {} {sum}", sums[i]);
                assert_eq!(counts[i], shown as f32, "{count}, {device:?}, {i}");
            }
        }
    }
}
