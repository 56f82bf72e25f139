use burn::tensor::{Device, Tensor, TensorData};

use super::*;
use crate::testing::finite::check_gradient;
use crate::testing::random::Random;

/// Accumulated depths, alphas and known depths.
struct Depths<T> {
    depth: T,
    alpha: T,
    known: T,
}

/// Accumulated depths, alphas of which a third is below a half, and `count` samples in ascending order, some of one pixel and some beyond
/// the picture; exact in f32.
fn inputs(plane: usize, count: usize) -> (Depths<Vec<f64>>, Vec<i32>) {
    let mut random = Random::new((1000 * plane + count) as u64);
    let exact = |values: Vec<f64>| values.into_iter().map(|value| f64::from(value as f32)).collect::<Vec<f64>>();
    let alpha = exact(random.fill(plane, 0.25, 1.0));
    let depth = exact(alpha.iter().map(|alpha| alpha * random.between(1.0, 4.0)).collect());
    let known = exact(random.fill(count, 1.0, 4.0));
    let mut pixels: Vec<i32> = (0..count).map(|_| random.between(-2.0, plane as f64 + 2.0).floor() as i32).collect();
    pixels.sort_unstable_by_key(|&pixel| pixel as u32);
    (Depths { depth, alpha, known }, pixels)
}

/// Numbers of pixels and of samples.
const SIZES: [(usize, usize); 5] = [(40, 60), (3, 1), (5, 0), (700, 1500), (90, 5000)];

fn by_definition(inputs: &Depths<&[f64]>, pixels: &[i32]) -> f64 {
    let errors = pixels.iter().zip(inputs.known).filter_map(|(&pixel, known)| {
        let at = usize::try_from(pixel).ok().filter(|&at| at < inputs.alpha.len() && inputs.alpha[at] >= 0.5)?;
        Some((inputs.depth[at] / inputs.alpha[at] - known).abs() / known)
    });
    let errors: Vec<f64> = errors.collect();
    errors.iter().sum::<f64>() / errors.len().max(1) as f64
}

#[test]
fn the_miss_is_the_mean_relative_error_with_its_gradients() {
    let device = Device::flex();
    let tracked = |values: &[f64]| {
        let data = TensorData::new(values.to_vec(), [1, values.len(), 1]);
        Tensor::<3>::from_inner(Tensor::from_data(data, (&device, DType::F64))).require_grad()
    };
    for (plane, count) in SIZES {
        let (Depths { depth, alpha, known }, pixels) = inputs(plane, count);
        let slices = Depths { depth: &depth[..], alpha: &alpha[..], known: &known[..] };
        let [depths, alphas] = [&depth, &alpha].map(|values| tracked(values));
        let known = Tensor::<1>::from_data(TensorData::new(known.clone(), [count]), (&device, DType::F64));
        let at = Tensor::<1, Int>::from_data(TensorData::new(pixels.clone(), [count]), &device);
        let miss = depth_miss(&depths, &alphas, &known, &at).unwrap();
        let found = miss.clone().into_scalar::<f64>();
        assert!((found - by_definition(&slices, &pixels)).abs() < 1e-12, "{plane}, {count}: {found}");
        if count == 0 {
            continue;
        }
        let gradients = (miss * 3.0).backward();
        let [of_depth, of_alpha] = [&depths, &alphas]
            .map(|tensor| tensor.grad(&gradients).expect("tracked").into_data().try_to_vec::<f64>().unwrap());
        let stride = plane.div_ceil(100);
        check_gradient("depth", &depth, &of_depth, stride, |depth| {
            3.0 * by_definition(&Depths { depth, ..slices }, &pixels)
        });
        check_gradient("alpha", &alpha, &of_alpha, stride, |alpha| {
            3.0 * by_definition(&Depths { alpha, ..slices }, &pixels)
        });
    }
}

#[test]
fn tensors_get_their_gradients_and_other_shapes_are_refused() {
    let device = Device::flex();
    let picture = |values: [f32; 2]| Tensor::<3>::from_data(TensorData::new(values.to_vec(), [1, 2, 1]), &device);
    let tracked = |values| Tensor::from_inner(picture(values)).require_grad();
    let (depth, alpha) = (tracked([2.0, 3.0]), tracked([0.5, 1.0]));
    let known = Tensor::<1>::from_floats([2.0, 4.0, 1.0], &device);
    let pixels = |values: [i32; 3]| Tensor::<1, Int>::from_data(TensorData::from(values), &device);
    let miss_of = |pixels: Tensor<1, Int>| depth_miss(&depth, &alpha, &known, &pixels).unwrap();
    let values = |tensor: Option<Tensor<3>>| tensor.unwrap().into_data().try_to_vec::<f32>().unwrap();
    let miss = miss_of(pixels([0, 1, 1]));
    // 4 instead of 2, and 3 instead of 4 and 1: relative errors 1, 1/4 and 2.
    assert!((miss.clone().into_scalar::<f32>() - 3.25 / 3.0).abs() < 1e-6);
    let gradients = (miss * 3.0).backward();
    for (found, expected) in [(&depth, [1.0, -0.25 + 1.0]), (&alpha, [-4.0, 0.75 - 3.0])] {
        let found = values(found.grad(&gradients));
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}, {expected:?}");
    }
    assert_eq!(miss_of(pixels([-1, 2, i32::MAX])).into_scalar::<f32>(), 0.0);
    let few = known.clone().narrow(0, 0, 2);
    assert!(matches!(depth_miss(&depth, &alpha, &few, &pixels([0; 3])), Err(SplatError::Shape { name: "pixels", .. })));
}
