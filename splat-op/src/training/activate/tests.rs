//! The twin against the formulas, and the rule for usable Gaussians.

use burn::tensor::{DType, Device, Tensor, TensorData};

use super::cpu::{all_finite_cpu, opacities_cpu, opacity_slopes_cpu, scales_cpu};
use super::rule::Raw;
use super::*;
use crate::testing::random::Random;

const LOGITS: [f64; 13] = [0.0, -0.0, 0.3, -0.3, 5.0, -5.0, 20.0, -20.0, 50.0, -50.0, 88.0, -103.0, 1e-40];

fn opacities_of(logits: &[f64]) -> Vec<f64> {
    let count = logits.len();
    let rotations: Vec<f64> = (0..count).flat_map(|_| [1.0, 0.0, 0.0, 0.0]).collect();
    let zeros = vec![0.0; 3 * count];
    opacities_cpu(Raw { means: &zeros, rotations: &rotations, log_scales: &zeros, logit_opacities: logits, sh: &zeros })
}

#[test]
fn activations_are_the_exponential_and_the_sigmoid() {
    let mut random = Random::new(1);
    let logs = random.fill(3_000, -60.0, 60.0);
    for (scale, log) in scales_cpu(&logs).iter().zip(&logs) {
        assert_eq!(*scale, log.exp());
    }
    for (opacity, logit) in opacities_of(&LOGITS).iter().zip(LOGITS) {
        let expected = 1.0 / (1.0 + (-logit).exp());
        assert!((opacity - expected).abs() <= 1e-15 * expected, "{logit}: {opacity}");
    }
}

#[test]
fn slopes_keep_their_digits_where_one_minus_the_opacity_has_none() {
    let logits = [0.0, 3.0, -3.0, 17.0, -17.0, 40.0, -40.0, 80.0, -80.0];
    let narrow: Vec<f32> = logits.map(|logit| logit as f32).to_vec();
    let opacities: Vec<f32> = opacities_of(&logits).iter().map(|opacity| *opacity as f32).collect();
    for (slope, logit) in opacity_slopes_cpu(&narrow, &opacities).iter().zip(logits) {
        // The derivative, written so that f64 loses nothing: 1 / (2 cosh(x / 2))².
        let expected = (2.0 * (logit / 2.0_f64).cosh()).powi(-2);
        assert!((f64::from(*slope) - expected).abs() <= 1e-6 * expected, "{logit}: {slope:e}, not {expected:e}");
    }
}

/// One Gaussian.
#[derive(Clone, Debug)]
struct One {
    mean: [f32; 3],
    rotation: [f32; 4],
    log_scale: [f32; 3],
    logit: f32,
    sh: Vec<f32>,
}

const COLOURS: usize = 12;

fn good() -> One {
    One {
        mean: [1.0, -2.0, 3.0],
        rotation: [0.5, -0.5, 0.5, 0.5],
        log_scale: [-2.0, -1.0, 0.0],
        logit: 1.0,
        sh: vec![0.1; COLOURS],
    }
}

/// Function that sets one slot.
type SetValue = (&'static str, fn(&mut One, f32));

const SLOTS: [SetValue; 5] = [
    ("mean", |one, value| one.mean[1] = value),
    ("rotation", |one, value| one.rotation[2] = value),
    ("log_scale", |one, value| one.log_scale[2] = value),
    ("logit", |one, value| one.logit = value),
    ("sh", |one, value| one.sh[COLOURS - 1] = value),
];

/// Usability by the function on the host, and the opacity and its slope by the twin in f32.
fn judged(one: &One) -> (bool, f32, f32) {
    let usable = is_usable(&one.mean, &one.rotation, &one.log_scale, one.logit, [&one.sh[..5], &one.sh[5..]]);
    let opacity = opacities_cpu(Raw {
        means: &one.mean,
        rotations: &one.rotation,
        log_scales: &one.log_scale,
        logit_opacities: &[one.logit],
        sh: &one.sh,
    })[0];
    (usable, opacity, opacity_slopes_cpu(&[one.logit], &[opacity])[0])
}

#[test]
fn what_is_not_finite_masks_the_gaussian_whatever_the_slot() {
    assert!(judged(&good()).0);
    for (name, set) in SLOTS {
        for value in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut one = good();
            set(&mut one, value);
            assert_eq!(judged(&one), (false, 0.0, 0.0), "{name} = {value}");
        }
        for value in [1e-45, -1e-45, f32::MIN_POSITIVE, -0.0, 0.0] {
            let mut one = good();
            set(&mut one, value);
            let (usable, opacity, slope) = judged(&one);
            assert!(usable && opacity > 0.0 && slope > 0.0, "{name} = {value}");
        }
    }
}

#[test]
fn what_f32_cannot_compute_with_masks_the_gaussian_too() {
    // Whether the largest float, and its negative, are usable in each slot.
    let may = [("mean", false, false), ("rotation", true, true), ("log_scale", false, true), ("logit", true, true)];
    for ((name, set), (expected, plus, minus)) in SLOTS.into_iter().zip(may.into_iter().chain([("sh", false, false)])) {
        assert_eq!(name, expected);
        for (value, usable) in [(f32::MAX, plus), (f32::MIN, minus)] {
            let mut one = good();
            set(&mut one, value);
            assert_eq!(judged(&one).0, usable, "{name} = {value}");
        }
    }
    let with = |change: fn(&mut One)| {
        let mut one = good();
        change(&mut one);
        judged(&one).0
    };
    assert!(!with(|one| one.rotation = [0.0, -0.0, 0.0, 0.0]), "a zero quaternion");
    assert!(with(|one| one.rotation = [0.0, 1e-45, 0.0, 0.0]), "the shortest quaternion");
    assert!(with(|one| one.rotation = [1e30; 4]), "a long quaternion");
    assert!(with(|one| one.log_scale = [50.0, -50.0, 88.0]) && !with(|one| one.log_scale[0] = 88.01));
    assert!(with(|one| one.mean = [1e18; 3]) && !with(|one| one.mean[0] = -1.01e18));
}

#[test]
fn no_gradient_passes_a_masked_gaussian_even_where_one_is_not_finite() {
    #[expect(deprecated, reason = "NdArray is the second CPU backend that the project supports")]
    let devices = [Device::flex(), Device::ndarray()];
    for device in devices {
        let device = device.autodiff();
        let leaf = |values: &[f32]| Tensor::<1>::from_floats(values, &device).require_grad();
        let logits = leaf(&[0.5, f32::NAN, f32::NEG_INFINITY, 0.5, 1.0]);
        let logs =
            leaf(&[0.0, -1.0, 0.5, f32::NAN, 0.0, 0.0, f32::INFINITY, f32::MAX, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let constant = |shape| Tensor::<2>::ones(shape, &device);
        let raw = RawSplats {
            means: constant([5, 3]),
            rotations: constant([5, 4]),
            log_scales: logs.clone().reshape([5, 3]),
            logit_opacities: logits.clone(),
            sh: Tensor::from_data(
                TensorData::new([vec![0.1; 9], vec![f32::NAN; 3], vec![0.1; 3]].concat(), [5, 1, 3]),
                &device,
            ),
        };
        let (scales, opacities) = activated(&raw, None).unwrap();
        let loss = (scales * 2.0).sum() + (opacities * 4.0).sum();
        let mut grads = loss.backward();
        let host = |tensor: Tensor<1>| tensor.into_data().convert::<f32>().try_into_vec::<f32>().unwrap();
        let logits = host(logits.grad_remove(&mut grads).unwrap());
        // Gaussians masked by the logit, by the scale and by the colour.
        let slope = 1.0_f32.exp() / (1.0 + 1.0_f32.exp()).powi(2) * 4.0;
        assert!(logits[1] == 0.0 && logits[2] == 0.0 && logits[3] == 0.0, "{logits:?}");
        assert!((logits[4] - slope).abs() < 1e-6 && logits[0] > 0.9, "{logits:?}");
        let logs = host(logs.grad_remove(&mut grads).unwrap());
        assert!(logs[3] == 0.0 && logs[6] == 0.0 && logs[7] == 0.0, "{logs:?}");
        assert!((logs[0] - 2.0).abs() < 1e-6 && (logs[1] - 2.0 * (-1.0_f32).exp()).abs() < 1e-6, "{logs:?}");
    }
}

#[test]
fn a_number_that_is_not_finite_is_found_wherever_it_is() {
    for len in [1, 7, 16_384, 40_000] {
        let mut values = vec![1.0_f32; len];
        values[0] = f32::MAX;
        assert!(all_finite_cpu(&values));
        for at in [0, len / 2, len - 1] {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let kept = std::mem::replace(&mut values[at], bad);
                assert!(!all_finite_cpu(&values), "{bad} at {at} of {len}");
                values[at] = kept;
            }
        }
    }
    assert!(all_finite_cpu::<f64>(&[]));
    let device = Device::flex();
    let flag = |value: f64| non_finite(&Tensor::<2>::full([3, 2], value, (&device, DType::F64))).into_scalar::<i32>();
    assert_eq!([flag(1e300), flag(f64::NAN)], [0, 1]);
}

#[test]
fn what_does_not_fit_is_named() {
    let device = Device::flex();
    let zeros = |shape| Tensor::<2>::zeros(shape, &device);
    let raw = RawSplats {
        means: zeros([4, 3]),
        rotations: zeros([4, 4]),
        log_scales: zeros([4, 3]),
        logit_opacities: Tensor::zeros([4], &device),
        sh: Tensor::zeros([4, 1, 3], &device),
    };
    assert!(activated(&raw, None).is_ok());
    let named = |raw: RawSplats, name: &str| {
        let message = activated(&raw, None).expect_err("refused").to_string();
        assert!(message.contains(&format!("`{name}`")), "{message}");
    };
    named(RawSplats { rotations: zeros([3, 4]), ..raw.clone() }, "rotations");
    named(RawSplats { log_scales: zeros([4, 2]), ..raw.clone() }, "log_scales");
    named(RawSplats { logit_opacities: Tensor::zeros([5], &device), ..raw.clone() }, "logit_opacities");
    named(RawSplats { sh: Tensor::zeros([4, 1, 2], &device), ..raw.clone() }, "sh");
}
