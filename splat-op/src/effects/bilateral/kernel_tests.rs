//! Compares the kernels with their twins in f64.

use super::cpu::{slice_backward_cpu, slice_cpu};
use super::launch::{launch_slice, launch_slice_backward};
use super::tests::{SIZES, picture_and_grid};
use super::{SliceSize, Sliced};
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// More pixels around a place than a cube has units.
const LARGE: SliceSize = SliceSize { width: 130, height: 75, levels: 8, rows: 4, columns: 5 };

#[test]
fn pictures_and_gradients_agree_with_the_twin() {
    for size in SIZES.into_iter().chain([LARGE]) {
        let [image, grid] = picture_and_grid(size).map(|values| rounded(&values));
        let grad = rounded(&Random::new(3).fill(image.len(), -1.0, 1.0));
        let needs = Sliced { image: true, grid: true };
        let evaluate = |inputs: &[Vec<f64>]| {
            let slices = Sliced { image: &inputs[0][..], grid: &inputs[1][..] };
            let found = slice_backward_cpu(slices, &inputs[2], size, needs);
            vec![slice_cpu(slices, size), found.image, found.grid]
        };
        let reference = PerturbedReference::new(&[image.clone(), grid.clone(), grad.clone()], evaluate);
        for (form, gpu) in gpus() {
            let buffer = |values: &[f64]| Buffer::from_slice(&gpu, &to_f32(values));
            let inputs = Sliced { image: buffer(&image), grid: buffer(&grid) };
            let found = launch_slice_backward(&gpu, &inputs, &buffer(&grad), size, needs);
            let out =
                [launch_slice(&gpu, &inputs, size), found.image.expect("asked for"), found.grid.expect("asked for")];
            for (i, (what, out)) in ["picture", "of the picture", "of the grid"].iter().zip(out).enumerate() {
                let out = out.read(&gpu);
                reference.check(&format!("{size:?}, {form}: {what}"), i, &out, &vec![Some(0); out.len()]);
            }
        }
    }
}
