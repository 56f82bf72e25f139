//! Compares the kernels with their twin in f64.

use super::cpu::{corrected_backward_cpu, corrected_cpu};
use super::launch::{launch_corrected, launch_corrected_backward};
use super::tests::correction;
use super::{Corrected, POSE};
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

#[test]
fn corrected_poses_agree_with_the_twin() {
    for (seed, size) in [(1, 0.05), (2, 1.0)] {
        let inputs = correction(seed, size);
        let grad = rounded(&Random::new(6).fill(POSE, -1.0, 1.0));
        let evaluate = |values: &[Vec<f64>]| {
            let slices = Corrected { correction: &values[0][..], cam_from_world: &values[1][..] };
            vec![corrected_cpu(slices, 1.5), corrected_backward_cpu(slices, &values[2], 1.5)]
        };
        let [given, pose] = inputs.clone().into_array();
        let reference = PerturbedReference::new(&[given, pose, grad.clone()], evaluate);
        for (form, gpu) in gpus() {
            let device = inputs.each_ref().map(|values| Buffer::from_slice(&gpu, &to_f32(values)));
            let grad = Buffer::from_slice(&gpu, &to_f32(&grad));
            let pose = launch_corrected(&gpu, &device, 1.5).read(&gpu);
            reference.check(&format!("{size}, {form}: pose"), 0, &pose, &[Some(0)]);
            let of_correction = launch_corrected_backward(&gpu, &device, &grad, 1.5).read(&gpu);
            reference.check(&format!("{size}, {form}: gradient"), 1, &of_correction, &[Some(0)]);
        }
    }
}
