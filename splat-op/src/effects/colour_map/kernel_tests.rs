//! Compares the kernels with their twins in f64.

use super::cpu::{colour_map_backward_cpu, colour_map_cpu};
use super::launch::{launch_colour_map, launch_colour_map_backward};
use super::tests::{PIXELS, inputs};
use super::{MAP, Mapped};
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// More pixels than a cube sums.
const LARGE: usize = 40_000;

#[test]
fn pictures_and_gradients_agree_with_the_twin() {
    let needs = Mapped { image: true, map: true };
    for pixels in PIXELS.into_iter().chain([LARGE]) {
        let given = inputs(pixels);
        let grad = rounded(&Random::new(3).fill(3 * pixels, -1.0, 1.0));
        let evaluate = |values: &[Vec<f64>]| {
            let slices = Mapped { image: &values[0][..], map: &values[1][..] };
            let found = colour_map_backward_cpu(slices, &values[2], needs);
            vec![colour_map_cpu(slices), found.image, found.map]
        };
        let [image, map] = given.clone().into_array();
        let reference = PerturbedReference::new(&[image, map, grad.clone()], evaluate);
        for (form, gpu) in gpus() {
            let buffer = |values: &Vec<f64>| Buffer::from_slice(&gpu, &to_f32(values));
            let (device, grad) = (given.each_ref().map(buffer), buffer(&grad));
            let of = launch_colour_map_backward(&gpu, &device, &grad, needs);
            let found = [
                ("picture", launch_colour_map(&gpu, &device)),
                ("of the picture", of.image.expect("asked for")),
                ("of the map", of.map.expect("asked for")),
            ];
            for (i, (what, found)) in found.into_iter().enumerate() {
                let found = found.read(&gpu);
                // The map's columns share a class: their sums have one size.
                let classes = vec![Some(0); if found.len() == MAP { MAP } else { found.len() }];
                reference.check(&format!("{pixels}, {form}: {what}"), i, &found, &classes);
            }
        }
    }
}
