use burn::tensor::{Device, Tensor};

use super::cpu::{smoothed_opacities_backward_cpu, smoothed_opacities_cpu, smoothed_scales_cpu};
use super::*;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

/// Standard deviations from far below to far above the widths, and opacities and widths, exact in f32.
pub(super) fn inputs(count: usize) -> Smooth<Vec<f64>> {
    let mut random = Random::new(count as u64);
    let exponentials = |random: &mut Random, count: usize| -> Vec<f64> {
        (0..count).map(|_| f64::from(random.between(-6.0, 3.0).exp() as f32)).collect()
    };
    let (scales, widths) = (exponentials(&mut random, 3 * count), exponentials(&mut random, count));
    let opacities = random.fill(count, 0.1, 0.9).into_iter().map(|value| f64::from(value as f32)).collect();
    Smooth { scales, opacities, widths }
}

#[test]
fn squares_add_up_and_the_integral_stays() {
    let inputs = inputs(40);
    let scales = smoothed_scales_cpu(&inputs.scales, &inputs.widths);
    let opacities = smoothed_opacities_cpu(inputs.each_ref().map(|values| &values[..]));
    for i in 0..40 {
        let (old, new) = (&inputs.scales[3 * i..][..3], &scales[3 * i..][..3]);
        let (mut before, mut after) = (inputs.opacities[i], opacities[i]);
        for (old, new) in old.iter().zip(new) {
            let square = old * old + inputs.widths[i] * inputs.widths[i];
            assert!((new * new / square - 1.0).abs() < 1e-14);
            (before, after) = (before * old, after * new);
        }
        assert!((after / before - 1.0).abs() < 1e-14);
    }
}

#[test]
fn gradients_are_those_of_differences() {
    let inputs = inputs(9);
    let weights = Random::new(2).fill(9, -1.0, 1.0);
    let found = smoothed_opacities_backward_cpu(inputs.each_ref().map(|values| &values[..]), &weights);
    let total = |scales: &[f64], opacities: &[f64]| {
        inner_product(&smoothed_opacities_cpu(Smooth { scales, opacities, widths: &inputs.widths[..] }), &weights)
    };
    check_gradient("opacities", &inputs.opacities, &found.opacities, 1, |at| total(&inputs.scales, at));
    // Steps of differences are absolute, and the smallest standard deviations are below them.
    let logs: Vec<f64> = inputs.scales.iter().map(|scale| scale.ln()).collect();
    let of_logs: Vec<f64> = found.scales.iter().zip(&inputs.scales).map(|(grad, scale)| grad * scale).collect();
    check_gradient("scales", &logs, &of_logs, 1, |logs| {
        total(&logs.iter().map(|log| log.exp()).collect::<Vec<_>>(), &inputs.opacities)
    });
}

#[test]
fn sizes_whose_squares_no_f32_holds() {
    for size in [1e-25_f32, 1e25] {
        let (scales, widths, opacities) = ([3.0 * size, 4.0 * size, 0.0], [4.0 * size], [0.5_f32]);
        let found = smoothed_scales_cpu(&scales, &widths);
        for (found, expected) in found.iter().zip([5.0 * size, 32_f32.sqrt() * size, 4.0 * size]) {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} instead of {expected}");
        }
        let inputs = Smooth { scales: &scales[..], opacities: &opacities[..], widths: &widths[..] };
        assert_eq!(smoothed_opacities_cpu(inputs), [0.0]);
        let grads = smoothed_opacities_backward_cpu(inputs, &[1.0]);
        assert!(grads.scales.iter().all(|grad| grad.is_finite()) && grads.scales[2] > 0.0, "{:?}", grads.scales);
    }
}

/// The determinant of 10⁻¹² scene units would be 10⁻⁷², which is 0 in f32, and its ratio 0 / 0.
#[test]
fn tiny_gaussians_keep_their_share() {
    let tiny = [1e-12_f32; 3];
    let inputs = Smooth { scales: &tiny[..], opacities: &[1.0][..], widths: &tiny[..1] };
    let share = smoothed_opacities_cpu(inputs)[0];
    assert!((share - 0.5_f32.powf(1.5)).abs() < 1e-6, "{share}");
    // d ln o' / d ln s = 1 / (1 + s²/g²), a half each.
    let gradient = smoothed_opacities_backward_cpu(inputs, &[1.0 / share]).scales;
    assert!(gradient.iter().all(|value| (value * 1e-12 - 0.5).abs() < 1e-6), "{gradient:?}");
}

#[test]
fn tensors_get_their_gradients_and_other_shapes_are_refused() {
    let device = Device::flex().autodiff();
    let scales = Tensor::<2>::from_floats([[3.0, 3.0, 3.0]], &device).require_grad();
    let opacities = Tensor::<1>::from_floats([0.5], &device).require_grad();
    let widths = Tensor::<2>::from_floats([[4.0]], &device);
    let (convolved, fainter) = smoothed(&scales, &opacities, &widths).unwrap();
    let gradients = (convolved.sum() + fainter.sum()).backward();
    // s' = 5, r = 3/5; ∂s'/∂s = 3/5, ∂o'/∂s = ½ (4/5)² (3/5)² / 5, ∂o'/∂o = (3/5)³.
    let of_scales = scales.grad(&gradients).unwrap().into_data().try_to_vec::<f32>().unwrap();
    assert!(of_scales.iter().all(|grad| (grad - (0.6 + 0.5 * 0.64 * 0.36 / 5.0)).abs() < 1e-6), "{of_scales:?}");
    let of_opacities = opacities.grad(&gradients).unwrap().into_scalar::<f32>();
    assert!((of_opacities - 0.216).abs() < 1e-6, "{of_opacities}");
    let wrong = Tensor::<2>::ones([2, 1], &device);
    assert!(matches!(smoothed(&scales, &opacities, &wrong), Err(SplatError::Shape { name: "widths", .. })));
}
