//! Compares the tally with its equations in f64.

use super::launch::launch_tally;
use crate::gpu::Buffer;
use crate::testing::ceiling::to_f32;
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

#[test]
fn three_steps_add_up() {
    let per_axis = [48.0_f32, 32.0];
    for count in [1, 255, 256, 5_000] {
        let mut random = Random::new(count as u64);
        let mut steps: Vec<Vec<f32>> = (0..3).map(|_| to_f32(&random.fill(2 * count, -1e-3, 1e-3))).collect();
        steps.iter_mut().for_each(|step| step.chunks_exact_mut(14).for_each(|row| row[..2].fill(0.0)));
        steps[1][0] = f32::NAN;
        for (form, gpu) in gpus() {
            let [sums, counts] = [(); 2].map(|()| Buffer::<f32>::new(&gpu, count));
            for (i, step) in steps.iter().enumerate() {
                launch_tally(&gpu, &Buffer::from_slice(&gpu, step), &sums, &counts, per_axis, i == 0);
            }
            let (sums, counts) = (sums.read(&gpu), counts.read(&gpu));
            assert!(sums[0].is_nan() && counts[0] <= 2.0, "{form}: NaN became {} of {}", sums[0], counts[0]);
            for i in 1..count {
                let norm = |step: &Vec<f32>| (f64::from(step[2 * i]) * 48.0).hypot(f64::from(step[2 * i + 1]) * 32.0);
                let norms: Vec<f64> = steps.iter().map(norm).collect();
                let (sum, shown) = (norms.iter().sum::<f64>(), norms.iter().filter(|norm| **norm > 0.0).count());
                assert!((f64::from(sums[i]) - sum).abs() <= 1e-6 * sum, "{count}, {form}, {i}: {} {sum}", sums[i]);
                assert_eq!(counts[i], shown as f32, "{count}, {form}, {i}");
            }
        }
    }
}
