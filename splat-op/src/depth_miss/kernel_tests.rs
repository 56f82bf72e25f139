//! Compares the kernels with their twin in f64.

use super::Depths;
use super::cpu::{depth_miss_backward_cpu, depth_miss_cpu};
use super::launch::{launch_depth_miss, launch_depth_miss_backward};
use super::tests::{SIZES, inputs};
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, to_f32};
use crate::testing::gpu::gpus;

#[test]
fn misses_and_gradients_agree_with_the_twin() {
    let needs = Depths { depth: true, alpha: true, known: false };
    for (plane, count) in SIZES {
        let (inputs, pixels) = inputs(plane, count);
        let evaluate = |values: &[Vec<f64>]| {
            let slices = Depths { depth: &values[0][..], alpha: &values[1][..], known: &values[2][..] };
            let found = depth_miss_backward_cpu(slices, &pixels, values[3][0], needs);
            vec![depth_miss_cpu(slices, &pixels), found.depth, found.alpha]
        };
        let [depth, alpha, known] = inputs.clone().into_array();
        let reference = PerturbedReference::new(&[depth, alpha, known, vec![0.75]], evaluate);
        for (form, gpu) in gpus() {
            let device = inputs.each_ref().map(|values| Buffer::from_slice(&gpu, &to_f32(values)));
            let samples: Vec<u32> = pixels.iter().map(|&pixel| pixel as u32).collect();
            let (samples, grad) = (Buffer::from_slice(&gpu, &samples), Buffer::from_slice(&gpu, &[0.75]));
            let value = launch_depth_miss(&gpu, &device, &samples).read(&gpu);
            reference.check(&format!("{plane}, {count}, {form}: value"), 0, &value, &[Some(0)]);
            let gradients = launch_depth_miss_backward(&gpu, &device, &samples, &grad);
            for (i, (what, found)) in ["of depth", "of alpha"].into_iter().zip(gradients).enumerate() {
                let found = found.read(&gpu);
                let name = format!("{plane}, {count}, {form}: {what}");
                reference.check(&name, 1 + i, &found, &vec![Some(0); plane]);
            }
        }
    }
}
