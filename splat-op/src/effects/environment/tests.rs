use burn::tensor::{Device, Tensor};

use super::cpu::{environment_backward_cpu, environment_cpu};
use super::*;
use crate::sh::harmonics;
use crate::testing::random::Random;

/// Image, alpha, directions and coefficients in f64. The directions are exact in f32 and therefore not quite of unit length.
pub(super) fn inputs(pixels: usize, count: usize) -> Sky<Vec<f64>> {
    let mut random = Random::new((1000 * pixels + count) as u64);
    let mut directions = random.fill(3 * pixels, -1.0, 1.0);
    for pixel in 0..pixels {
        let along = [0, 1, 2].map(|axis| axis * pixels + pixel);
        let length = along.iter().map(|&at| directions[at] * directions[at]).sum::<f64>().sqrt();
        along.into_iter().for_each(|at| directions[at] = f64::from((directions[at] / length) as f32));
    }
    Sky {
        image: random.fill(3 * pixels, 0.0, 1.0),
        alpha: random.fill(pixels, 0.0, 1.0),
        directions,
        coefficients: random.fill(3 * count, -0.5, 0.5),
    }
}

/// Every degree; fewer pixels than a vector has lanes, and a run and a part of one.
pub(super) const SIZES: [(usize, usize); 5] = [(1, 1), (13, 9), (4096 + 1001, 4), (40, 16), (30, 25)];

fn by_definition(inputs: &Sky<Vec<f64>>) -> Vec<f64> {
    let pixels = inputs.alpha.len();
    let value = |i: usize| {
        let (channel, pixel) = (i / pixels, i % pixels);
        let direction = [0, 1, 2].map(|axis| inputs.directions[axis * pixels + pixel]);
        let count = inputs.coefficients.len() / 3;
        let values = harmonics(direction, sh_degree(count).unwrap());
        let rows = inputs.coefficients.chunks(3).zip(values);
        let sky = 0.5 + rows.map(|(row, value)| row[channel] * value).sum::<f64>();
        inputs.image[i] + (1.0 - inputs.alpha[pixel]) * sky
    };
    (0..3 * pixels).map(value).collect()
}

#[test]
fn the_sky_shows_where_nothing_covers_it() {
    for (pixels, count) in SIZES {
        let inputs = inputs(pixels, count);
        let found = environment_cpu(inputs.each_ref().map(|values| &values[..]));
        for (found, expected) in found.iter().zip(by_definition(&inputs)) {
            assert!((found - expected).abs() < 1e-12, "{pixels}, {count}: {found} instead of {expected}");
        }
    }
}

#[test]
fn gradients_are_the_differences_of_the_definition() {
    let by = 1e-6;
    for (pixels, count) in SIZES {
        let inputs = inputs(pixels, count);
        let weights = Random::new(5).fill(3 * pixels, -1.0, 1.0);
        let total = |inputs: &Sky<Vec<f64>>| -> f64 {
            by_definition(inputs).iter().zip(&weights).map(|(value, weight)| value * weight).sum()
        };
        let needs = Sky { image: false, alpha: true, directions: false, coefficients: true };
        let found = environment_backward_cpu(inputs.each_ref().map(|values| &values[..]), &weights, needs);
        assert_eq!([found.alpha.len(), found.coefficients.len()], [pixels, 3 * count]);
        let check = |i: usize, found: f64, moved: &dyn Fn(&mut Sky<Vec<f64>>, f64)| {
            let at = |by: f64| {
                let mut inputs = inputs.clone();
                moved(&mut inputs, by);
                total(&inputs)
            };
            let expected = (at(by) - at(-by)) / (2.0 * by);
            assert!((found - expected).abs() < 1e-6 * expected.abs().max(1.0), "{i}: {found} instead of {expected}");
        };
        for i in (0..pixels).step_by(97) {
            check(i, found.alpha[i], &|inputs, by| inputs.alpha[i] += by);
        }
        for i in 0..3 * count {
            check(i, found.coefficients[i], &|inputs, by| inputs.coefficients[i] += by);
        }
    }
}

#[test]
fn tensors_get_their_gradients_and_other_shapes_are_refused() {
    let device = Device::flex().autodiff();
    let image = Tensor::<3>::zeros([2, 4, 3], &device).require_grad();
    let alpha = Tensor::<3>::full([2, 4, 1], 0.25, &device).require_grad();
    let directions = Tensor::<3>::full([3, 2, 4], 3f64.sqrt().recip(), &device);
    let coefficients = Tensor::<2>::full([1, 3], 0.1, &device).require_grad();
    let composed = over(&image, &alpha, &directions, &coefficients).unwrap();
    assert_eq!(composed.dims(), [2, 4, 3]);
    let gradients = composed.sum().backward();
    let sum = |grad: Option<f32>, expected: f64| {
        assert!((f64::from(grad.unwrap()) - expected).abs() < 1e-4, "{grad:?} instead of {expected}");
    };
    let y0 = 0.5 / std::f64::consts::PI.sqrt();
    sum(image.grad(&gradients).map(|grad| grad.sum().into_scalar()), 24.0);
    sum(alpha.grad(&gradients).map(|grad| grad.sum().into_scalar()), -8.0 * 3.0 * (0.5 + 0.1 * y0));
    sum(coefficients.grad(&gradients).map(|grad| grad.sum().into_scalar()), 8.0 * 3.0 * 0.75 * y0);
    for rows in [0, 2, 36] {
        let wrong = Tensor::<2>::zeros([rows, 3], &device);
        let refused = over(&image, &alpha, &directions, &wrong);
        assert!(matches!(refused, Err(SplatError::Shape { name: "coefficients", .. })), "{rows}");
    }
    let wrong = Tensor::<3>::zeros([4, 2, 4], &device);
    let refused = over(&image, &alpha, &wrong, &coefficients);
    assert!(matches!(refused, Err(SplatError::Shape { name: "directions", .. })));
}
