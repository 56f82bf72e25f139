use burn::tensor::{Device, Tensor};

use super::cpu::{colour_map_backward_cpu, colour_map_cpu};
use super::*;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

/// A picture and a map, exact in f32.
pub(super) fn inputs(pixels: usize) -> Mapped<Vec<f64>> {
    let mut random = Random::new(pixels as u64);
    let mut fill = |count: usize, low: f64| random.fill(count, low, 1.0).iter().map(|v| f64::from(*v as f32)).collect();
    Mapped { image: fill(3 * pixels, 0.0), map: fill(MAP, -1.0) }
}

/// Fewer pixels than a vector has lanes, and two runs and a part of one.
pub(super) const PIXELS: [usize; 3] = [1, 13, 2 * 4096 + 1001];

#[test]
fn the_map_is_affine_in_the_colour() {
    for pixels in PIXELS {
        let inputs = inputs(pixels);
        let found = colour_map_cpu(inputs.each_ref().map(|values| &values[..]));
        for pixel in 0..pixels {
            for (row, weights) in inputs.map.chunks(4).enumerate() {
                let colour = [0, 1, 2].map(|channel| inputs.image[channel * pixels + pixel]);
                let expected = weights[3] + (0..3).map(|i| weights[i] * colour[i]).sum::<f64>();
                assert!((found[row * pixels + pixel] - expected).abs() < 1e-14);
            }
        }
    }
}

#[test]
fn gradients_are_those_of_differences() {
    for pixels in PIXELS {
        let inputs = inputs(pixels);
        let weights = Random::new(2).fill(3 * pixels, -1.0, 1.0);
        let needs = Mapped { image: true, map: true };
        let found = colour_map_backward_cpu(inputs.each_ref().map(|values| &values[..]), &weights, needs);
        let total = |image: &[f64], map: &[f64]| inner_product(&colour_map_cpu(Mapped { image, map }), &weights);
        check_gradient("map", &inputs.map, &found.map, 1, |map| total(&inputs.image, map));
        check_gradient("image", &inputs.image, &found.image, 1 + 3 * pixels / 40, |image| total(image, &inputs.map));
        let none = Mapped { image: false, map: false };
        let found = colour_map_backward_cpu(inputs.each_ref().map(|values| &values[..]), &weights, none);
        assert_eq!([found.image.len(), found.map.len()], [0, 0]);
    }
}

#[test]
fn tensors_get_their_gradients_and_other_shapes_are_refused() {
    let device = Device::flex().autodiff();
    let image = Tensor::<3>::ones([2, 4, 3], &device).require_grad();
    let map = Tensor::<2>::from_floats([[1.0, 2.0, 3.0, 4.0]; 3], &device).require_grad();
    let mapped = apply(&image, &map).unwrap();
    assert_eq!(mapped.dims(), [2, 4, 3]);
    let gradients = mapped.sum().backward();
    let of_image = image.grad(&gradients).unwrap().into_data().try_to_vec::<f32>().unwrap();
    assert_eq!(of_image.chunks(3).map(|row| row.to_vec()).collect::<Vec<_>>(), vec![vec![3.0, 6.0, 9.0]; 8]);
    assert_eq!(map.grad(&gradients).unwrap().into_data().try_to_vec::<f32>().unwrap(), [8.0; MAP]);
    let wrong = Tensor::<2>::zeros([3, 3], &device);
    assert!(matches!(apply(&image, &wrong), Err(SplatError::Shape { name: "map", .. })));
}
