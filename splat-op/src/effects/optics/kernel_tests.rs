//! Compares the kernels with their twins in f64.

use super::cpu::{expose_backward_cpu, expose_cpu};
use super::launch::{launch_expose, launch_expose_backward};
use super::tests::{TWIST, ellipses, exposures};
use super::{Exposed, PARAMETERS};
use crate::gpu::Buffer;
use crate::project::COLUMNS;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// Rows of ordinary, thin, far and culled ellipses.
fn classes(count: usize) -> Vec<Option<u8>> {
    (0..count)
        .map(|i| {
            Some(if i % 11 == 7 {
                3
            } else if i % 4 == 1 {
                1
            } else {
                2 * u8::from(i % 5 == 4)
            })
        })
        .collect()
}

#[test]
fn ellipses_and_gradients_agree_with_the_twin() {
    for (kind, spec) in exposures().into_iter().enumerate() {
        // None, one, and more than a cube.
        for count in [0, 1, 1_300] {
            let mut projected = ellipses(count, 20 + count as u64);
            for row in projected.chunks_mut(COLUMNS).skip(7).step_by(11) {
                row.copy_from_slice(&[0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
            }
            let grad = rounded(&Random::new(3).fill(COLUMNS * count, -1.0, 1.0));
            let evaluate = |inputs: &[Vec<f64>]| {
                let slices = Exposed { projected: &inputs[0][..], twist: &inputs[1][..] };
                let found = expose_backward_cpu(slices, &inputs[2], &spec);
                vec![expose_cpu(slices, &spec), found.projected, found.twist]
            };
            let all = [projected.clone(), TWIST.to_vec(), grad.clone()];
            let reference = PerturbedReference::new(&all, evaluate);
            for (form, gpu) in gpus() {
                let buffer = |values: &[f64]| Buffer::from_slice(&gpu, &to_f32(values));
                let inputs = Exposed { projected: buffer(&projected), twist: buffer(&TWIST) };
                let what = |what: &str| format!("exposure {kind}, {count}, {form}: {what}");
                let found = launch_expose(&gpu, &inputs, &spec).read(&gpu);
                reference.check(&what("ellipses"), 0, &found, &classes(count));
                let found = launch_expose_backward(&gpu, &inputs, &buffer(&grad), &spec);
                reference.check_gradient(&what("of ellipses"), 1, &found.projected.read(&gpu), &classes(count), &[]);
                reference.check(&what("of the twist"), 2, &found.twist.read(&gpu), &[Some(0); PARAMETERS]);
            }
        }
    }
}
