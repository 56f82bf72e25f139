use burn::tensor::{DType, Device, Tensor, TensorData};

use super::*;
use crate::SplatError;
use crate::testing::devices;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

/// Numbers of a map.
const MAP: usize = 12;

/// A picture, in planes, and a map, or their gradients.
struct Mapped<T> {
    image: T,
    map: T,
}

/// Numbers exact in f32.
fn inputs(pixels: usize) -> Mapped<Vec<f64>> {
    let mut random = Random::new(pixels as u64);
    let mut fill = |count: usize, low: f64| random.fill(count, low, 1.0).iter().map(|v| f64::from(*v as f32)).collect();
    Mapped { image: fill(3 * pixels, 0.0), map: fill(MAP, -1.0) }
}

/// One pixel, one row, and several rows.
const SIZES: [[usize; 2]; 3] = [[1, 1], [1, 13], [71, 131]];

fn by_definition(image: &[f64], map: &[f64]) -> Vec<f64> {
    let pixels = image.len() / 3;
    let shown = |row: &[f64], pixel: usize| row[3] + (0..3).map(|c| row[c] * image[c * pixels + pixel]).sum::<f64>();
    map.chunks(4).flat_map(|row| (0..pixels).map(move |pixel| shown(row, pixel))).collect()
}

/// The mapped picture, and the gradients of its sum with these weights; all in planes.
fn found(
    inputs: &Mapped<Vec<f64>>,
    weights: &[f64],
    size: [usize; 2],
    on: (&Device, DType),
) -> (Vec<f64>, Mapped<Vec<f64>>) {
    let planes = |values: &[f64]| {
        let data = TensorData::new(values.to_vec(), [3, size[0], size[1]]);
        Tensor::from_inner(Tensor::<3>::from_data(data, on))
    };
    let image = planes(&inputs.image).require_grad();
    let map = Tensor::<2>::from_data(TensorData::new(inputs.map.clone(), [3, 4]), on);
    let map = Tensor::from_inner(map).require_grad();
    let shown = apply(&image.clone().permute([1, 2, 0]), &map).unwrap().permute([2, 0, 1]);
    let gradients = (shown.clone() * planes(weights)).sum().backward();
    let host = |data: TensorData| data.iter::<f64>().collect::<Vec<_>>();
    let of_image = host(image.grad(&gradients).expect("tracked").into_data());
    (host(shown.into_data()), Mapped { image: of_image, map: host(map.grad(&gradients).expect("tracked").into_data()) })
}

#[test]
fn the_map_is_affine_in_the_colour_and_gradients_are_those_of_differences() {
    for size in SIZES {
        let inputs = inputs(size[0] * size[1]);
        let weights = Random::new(2).fill(inputs.image.len(), -1.0, 1.0);
        let (shown, of) = found(&inputs, &weights, size, (&Device::flex(), DType::F64));
        for (shown, expected) in shown.iter().zip(by_definition(&inputs.image, &inputs.map)) {
            assert!((shown - expected).abs() < 1e-14, "{size:?}: {shown} instead of {expected}");
        }
        let total = |image: &[f64], map: &[f64]| inner_product(&by_definition(image, map), &weights);
        check_gradient("map", &inputs.map, &of.map, 1, |map| total(&inputs.image, map));
        check_gradient("image", &inputs.image, &of.image, 1 + weights.len() / 40, |image| total(image, &inputs.map));
    }
}

#[test]
fn every_device_agrees_with_f64() {
    let close = |found: &[f64], expected: &[f64], tolerance: f64, what: &str| {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < tolerance, "{what}: {found} instead of {expected}");
        }
    };
    for size in SIZES {
        let inputs = inputs(size[0] * size[1]);
        let weights: Vec<f64> =
            Random::new(3).fill(inputs.image.len(), -1.0, 1.0).iter().map(|weight| f64::from(*weight as f32)).collect();
        let (expected, of_expected) = found(&inputs, &weights, size, (&Device::flex(), DType::F64));
        for device in devices() {
            let (shown, of) = found(&inputs, &weights, size, (&device, DType::F32));
            close(&shown, &expected, 1e-6, &format!("{size:?}, {device:?}: picture"));
            close(&of.image, &of_expected.image, 1e-6, &format!("{size:?}, {device:?}: of the picture"));
            // Sums over all pixels.
            close(&of.map, &of_expected.map, 1e-3, &format!("{size:?}, {device:?}: of the map"));
        }
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
