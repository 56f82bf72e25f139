//! Compares the kernels with their twins in f64.

use super::Smooth;
use super::cpu::{smoothed_opacities_backward_cpu, smoothed_opacities_cpu, smoothed_scales_cpu};
use super::launch::{launch_smoothed_opacities, launch_smoothed_opacities_backward, launch_smoothed_scales};
use super::tests::inputs;
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

#[test]
fn values_and_gradients_agree_with_the_twin() {
    for count in [0, 1, 1_300] {
        let given = inputs(count);
        let grad = rounded(&Random::new(3).fill(count, -1.0, 1.0));
        let evaluate = |values: &[Vec<f64>]| {
            let inputs = Smooth { scales: &values[0][..], opacities: &values[1][..], widths: &values[2][..] };
            let found = smoothed_opacities_backward_cpu(inputs, &values[3]);
            let scales = smoothed_scales_cpu(inputs.scales, inputs.widths);
            vec![scales, smoothed_opacities_cpu(inputs), found.scales, found.opacities]
        };
        let [scales, opacities, widths] = given.clone().into_array();
        let reference = PerturbedReference::new(&[scales, opacities, widths, grad.clone()], evaluate);
        for (form, gpu) in gpus() {
            let buffer = |values: &Vec<f64>| Buffer::from_slice(&gpu, &to_f32(values));
            let device = given.each_ref().map(buffer);
            let (of_scales, of_opacities) = launch_smoothed_opacities_backward(&gpu, &device, &buffer(&grad));
            let found = [
                ("scales", launch_smoothed_scales(&gpu, &device.scales, &device.widths)),
                ("opacities", launch_smoothed_opacities(&gpu, &device)),
                ("of scales", of_scales),
                ("of opacities", of_opacities),
            ];
            for (i, (what, found)) in found.into_iter().enumerate() {
                reference.check(&format!("{count}, {form}: {what}"), i, &found.read(&gpu), &vec![Some(0); count]);
            }
        }
    }
}
