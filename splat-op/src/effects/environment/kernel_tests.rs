//! Compares the kernels with their twins in f64.

use super::Sky;
use super::cpu::{environment_backward_cpu, environment_cpu};
use super::launch::{launch_alpha_backward, launch_coefficients_backward, launch_environment};
use super::tests::{SIZES, inputs};
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// More pixels than a cube sums.
const LARGE: (usize, usize) = (40_000, 4);

#[test]
fn pictures_and_gradients_agree_with_the_twin() {
    let needs = Sky { image: false, alpha: true, directions: false, coefficients: true };
    for (pixels, count) in SIZES.into_iter().chain([LARGE]) {
        let inputs = inputs(pixels, count).map(|values| rounded(&values));
        let grad = rounded(&Random::new(3).fill(3 * pixels, -1.0, 1.0));
        let [image, alpha, directions, coefficients] = inputs.clone().into_array();
        let evaluate = |inputs: &[Vec<f64>]| {
            let slices = Sky {
                image: &inputs[0][..],
                alpha: &inputs[1][..],
                directions: &inputs[2][..],
                coefficients: &inputs[3][..],
            };
            let found = environment_backward_cpu(slices, &inputs[4], needs);
            vec![environment_cpu(slices), found.alpha, found.coefficients]
        };
        let all = [image, alpha, directions, coefficients, grad.clone()];
        let reference = PerturbedReference::new(&all, evaluate);
        for (form, gpu) in gpus() {
            let buffer = |values: &[f64]| Buffer::from_slice(&gpu, &to_f32(values));
            let (inputs, grad) = (inputs.each_ref().map(|values| buffer(values)), buffer(&grad));
            let found = [
                ("picture", launch_environment(&gpu, &inputs)),
                ("of alpha", launch_alpha_backward(&gpu, &inputs, &grad)),
                ("of the coefficients", launch_coefficients_backward(&gpu, &inputs, &grad)),
            ];
            for (i, (what, found)) in found.into_iter().enumerate() {
                let found = found.read(&gpu);
                reference.check(&format!("{pixels}, {count}, {form}: {what}"), i, &found, &vec![Some(0); found.len()]);
            }
        }
    }
}
