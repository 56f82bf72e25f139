use burn::tensor::{Device, Tensor, TensorData};

use super::*;
use crate::SplatError;
use crate::testing::devices;
use crate::testing::random::Random;

/// New standard deviations and opacities, and the gradients of the standard deviations and opacities from those of the new opacities.
struct Found {
    scales: Vec<f32>,
    opacities: Vec<f32>,
    of_scales: Vec<f32>,
    of_opacities: Vec<f32>,
}

fn found(scales: &[f32], opacities: &[f32], widths: &[f32], grad: &[f32], device: &Device) -> Found {
    let (device, count) = (device.clone().autodiff(), opacities.len());
    let column = |values: &[f32], columns: usize| TensorData::new(values.to_vec(), [count, columns]);
    let scales = Tensor::<2>::from_data(column(scales, 3), &device).require_grad();
    let opacities = Tensor::<1>::from_floats(opacities, &device).require_grad();
    let widths = Tensor::<2>::from_data(column(widths, 1), &device);
    let (wide, fainter) = smoothed(&scales, &opacities, &widths).expect("tensors that fit");
    let gradients = (fainter.clone() * Tensor::from_floats(grad, &device)).sum().backward();
    let host = |data: TensorData| data.try_to_vec::<f32>().expect("f32");
    Found {
        scales: host(wide.into_data()),
        opacities: host(fainter.into_data()),
        of_scales: host(scales.grad(&gradients).expect("tracked").into_data()),
        of_opacities: host(opacities.grad(&gradients).expect("tracked").into_data()),
    }
}

/// Standard deviations from far below to far above the widths.
#[test]
fn values_and_gradients_are_those_of_the_equations() {
    for device in devices() {
        for count in [1, 40, 1_300] {
            let mut random = Random::new(count as u64);
            let mut spread = |count: usize, low: f64, high: f64| -> Vec<f32> {
                (0..count).map(|_| random.between(low, high).exp() as f32).collect()
            };
            let (scales, widths) = (spread(3 * count, -6.0, 3.0), spread(count, -6.0, 3.0));
            let (opacities, grad) = (spread(count, -2.0, -0.1), spread(count, -3.0, 0.0));
            let found = found(&scales, &opacities, &widths, &grad, &device);
            let close = |found: f32, expected: f64| (f64::from(found) / expected - 1.0).abs() < 2e-6;
            for i in 0..count {
                let [g, o, grad] = [widths[i], opacities[i], grad[i]].map(f64::from);
                let s: [f64; 3] = std::array::from_fn(|axis| scales[3 * i + axis].into());
                let wide = s.map(|s| s.hypot(g));
                let share: [f64; 3] = std::array::from_fn(|axis| s[axis] / wide[axis]);
                let product: f64 = share.iter().product();
                assert!(close(found.opacities[i], o * product), "{device:?}: {} {}", found.opacities[i], o * product);
                assert!(close(found.of_opacities[i], grad * product), "{device:?}: the gradient of an opacity");
                for axis in 0..3 {
                    let slope = o * (g / wide[axis]).powi(2) * product / share[axis] / wide[axis];
                    assert!(close(found.scales[3 * i + axis], wide[axis]), "{device:?}: a standard deviation");
                    let of_scale = found.of_scales[3 * i + axis];
                    assert!(close(of_scale, grad * slope), "{device:?}: {of_scale} instead of {}", grad * slope);
                }
            }
        }
    }
}

#[test]
fn sizes_whose_squares_no_f32_holds() {
    for device in devices() {
        for size in [1e-25_f32, 1e25] {
            let found = found(&[3.0 * size, 4.0 * size, 0.0], &[0.5], &[4.0 * size], &[1.0], &device);
            for (found, expected) in found.scales.iter().zip([5.0 * size, 32_f32.sqrt() * size, 4.0 * size]) {
                assert!((found / expected - 1.0).abs() < 1e-6, "{device:?}: {found} instead of {expected}");
            }
            assert_eq!(found.opacities, [0.0]);
            let grads = found.of_scales;
            assert!(grads.iter().all(|grad| grad.is_finite()) && grads[2] > 0.0, "{device:?}: {grads:?}");
        }
    }
}

/// The determinant of 10⁻¹² scene units would be 10⁻⁷², which is 0 in f32, and its ratio 0 / 0.
#[test]
fn tiny_gaussians_keep_their_share() {
    for device in devices() {
        let found = found(&[1e-12; 3], &[1.0], &[1e-12], &[1.0], &device);
        let share = found.opacities[0];
        assert!((share - 0.5_f32.powf(1.5)).abs() < 1e-6, "{device:?}: {share}");
        // d ln o' / d ln s = 1 / (1 + s²/g²), a half each.
        let gradient = found.of_scales;
        assert!(gradient.iter().all(|value| (value / share * 1e-12 - 0.5).abs() < 1e-6), "{device:?}: {gradient:?}");
    }
}

#[test]
fn both_results_have_gradients_and_other_shapes_are_refused() {
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
    let none = smoothed(&Tensor::zeros([0, 3], &device), &Tensor::zeros([0], &device), &Tensor::zeros([0, 1], &device));
    assert_eq!(none.unwrap().0.dims(), [0, 3]);
}
