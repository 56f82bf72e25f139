use burn::tensor::{DType, Device, Tensor, TensorData};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

fn tensor(values: &[f64], device: &Device, dtype: DType) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.to_vec(), [values.len() / 2, 2]), (device, dtype))
}

fn host(tensor: Tensor<2>) -> Vec<f64> {
    tensor.into_data().iter::<f64>().collect()
}

fn devices() -> [Device; 2] {
    #[expect(deprecated, reason = "NdArray is the second CPU backend that the project supports")]
    [Device::flex(), Device::ndarray()]
}

/// Reference implementation of the paper's algorithm 1.
fn reference(start: &[f64], gradients: &[Vec<f64>], lr: f64) -> Vec<f64> {
    let (beta1, beta2, eps) = (0.9, 0.999, 1e-15);
    let mut theta = start.to_vec();
    let (mut m, mut v) = (vec![0.0; theta.len()], vec![0.0; theta.len()]);
    for (t, gradient) in gradients.iter().enumerate() {
        let t = t as i32 + 1;
        for i in 0..theta.len() {
            m[i] = beta1 * m[i] + (1.0 - beta1) * gradient[i];
            v[i] = beta2 * v[i] + (1.0 - beta2) * gradient[i] * gradient[i];
            let m_hat = m[i] / (1.0 - f64::powi(beta1, t));
            let v_hat = v[i] / (1.0 - f64::powi(beta2, t));
            theta[i] -= lr * m_hat / (v_hat.sqrt() + eps);
        }
    }
    theta
}

#[test]
fn twenty_steps_follow_the_paper() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let start: Vec<f64> = (0..6).map(|_| rng.random_range(-1.0..1.0)).collect();
    // Magnitudes from 1 down to where epsilon counts.
    let gradients: Vec<Vec<f64>> = (0..20)
        .map(|_| [1.0, 1e-3, 1e-8, 1e-14, 1e-15, 0.0].map(|size| size * rng.random_range(-1.0..1.5)).to_vec())
        .collect();
    let expected = reference(&start, &gradients, 0.01);
    for device in devices() {
        for (dtype, tolerance) in [(DType::F64, 1e-12), (DType::F32, 2e-6)] {
            let mut param = tensor(&start, &device, dtype);
            let mut moments = Moments::new(&param);
            for (i, gradient) in gradients.iter().enumerate() {
                param = Adam::default().step(param, tensor(gradient, &device, dtype), 0.01, &mut moments, i + 1);
            }
            for (found, expected) in host(param).into_iter().zip(&expected) {
                assert!((found - expected).abs() <= tolerance, "{dtype:?}: {found} instead of {expected}");
            }
        }
    }
}

#[test]
fn host_memory_and_tensors_agree() {
    let device = Device::flex();
    // The count takes more than one chunk, and not a whole number of chunks.
    let count = 2 * 20_011;
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut random = || -> Vec<f64> { (0..count).map(|_| rng.random_range(-1.0..1.0)).collect() };
    for rate in [Rates::from(0.03), Rates { first: 0.3, others: 0.01, width: 1 }] {
        let start = tensor(&random(), &device, DType::F32);
        let first = Stepped { param: start.clone(), m: start.zeros_like(), v: start.zeros_like() };
        let mut both = [first.clone(), first];
        let factors = Factors { beta1: 0.9, beta2: 0.999, rate, floor: 1e-8, largest: LARGEST_GRADIENT };
        for _ in 0..3 {
            let grad = tensor(&random(), &device, DType::F32);
            let [host, tensors] = both;
            both = [step_in_host_memory(&factors, host, grad.clone()), step_in_tensors(&factors, tensors, grad)];
        }
        let [host_memory, tensors] = both.map(|stepped| host(stepped.param));
        for (a, b) in host_memory.iter().zip(&tensors) {
            assert!((a - b).abs() <= 1e-6 * b.abs().max(1.0), "{a} in host memory, {b} in tensors, {rate:?}");
        }
    }
}

#[test]
fn nothing_moves_without_gradients() {
    for device in devices() {
        let start = [0.5, -3.0];
        let mut param = tensor(&start, &device, DType::F32);
        let mut moments = Moments::new(&param);
        for t in 1..=3 {
            param = Adam::default().step(param, tensor(&[0.0, -0.0], &device, DType::F32), 0.1, &mut moments, t);
        }
        assert_eq!(host(param), start);
    }
}

#[test]
fn huge_gradients_take_bounded_steps() {
    for device in devices() {
        for size in [1e20, f64::MAX, f64::INFINITY] {
            let mut param = tensor(&[0.0, 0.0], &device, DType::F32);
            let mut moments = Moments::new(&param);
            for t in 1..=500 {
                param = Adam::default().step(param, tensor(&[size, -size], &device, DType::F32), 0.1, &mut moments, t);
                let bound = 0.1001 * t as f64;
                assert!(host(param.clone()).iter().all(|x| x.abs() <= bound && x.abs() > 0.099), "step {t}");
            }
            let ordinary = tensor(&[1.0, 1.0], &device, DType::F32);
            param = Adam::default().step(param, ordinary, 0.1, &mut moments, 501);
            assert!(host(param).iter().all(|x| x.is_finite()));
        }
    }
}

#[test]
fn a_shared_parameter_keeps_its_values() {
    for device in devices() {
        let before = tensor(&[1.0, 2.0], &device, DType::F32);
        let mut moments = Moments::new(&before);
        let after =
            Adam::default().step(before.clone(), tensor(&[1.0, 1.0], &device, DType::F32), 0.5, &mut moments, 1);
        assert_eq!(host(before), [1.0, 2.0]);
        assert!(host(after).iter().zip([0.5, 1.5]).all(|(found, expected)| (found - expected).abs() < 1e-6));
    }
}

#[test]
fn a_batch_forgets_as_much_per_photograph() {
    let adam = Adam::default();
    assert_eq!(adam.for_batch(1), adam);
    let four = adam.for_batch(4);
    assert!((four.beta1 - 0.6561).abs() < 1e-12 && (four.beta2 - 0.996_005_996_001).abs() < 1e-12, "{four:?}");
    assert_eq!(four.eps, 5e-16);
    let hundred = adam.for_batch(100);
    assert!(hundred.beta1 > 0.0 && hundred.beta2 > 0.9, "{hundred:?}");
}
