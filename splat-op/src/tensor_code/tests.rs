//! Operations against tensor code, in values and gradients, on every device. Each function is called twice and takes the one or the other.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};

use super::{in_tensor_code, is_tensor_code};
use crate::activate::{RawSplats, activated, non_finite};
use crate::argsort::{ALL_BITS, argsort, argsort_floats};
use crate::bilateral::{LUMA, slice};
use crate::environment::over;
use crate::optics::{blurred, rolled};
use crate::testing::devices;
use crate::testing::random::Random;
use crate::{Intrinsics, Projected, SplatError};

/// A function of inputs, `[numbers]` each, with one output.
type Function<'a> = &'a dyn Fn(&[Tensor<1>]) -> Tensor<1>;

fn shaped<const D: usize>(flat: &Tensor<1>, shape: [usize; D]) -> Tensor<D> {
    flat.clone().reshape(shape)
}

/// The output and the gradients of all inputs, for a sum of the output with fixed weights.
fn found(function: Function, inputs: &[Vec<f64>], device: &Device, dtype: DType) -> Vec<Vec<f64>> {
    let leaf = |values: &Vec<f64>| {
        let data = TensorData::new(values.clone(), [values.len()]);
        Tensor::<1>::from_inner(Tensor::from_data(data, (device, dtype))).require_grad()
    };
    let leaves: Vec<_> = inputs.iter().map(leaf).collect();
    let out = function(&leaves);
    let weights = Random::new(9).fill(out.dims()[0], 0.25, 1.0);
    let weights = Tensor::<1>::from_data(TensorData::new(weights, [out.dims()[0]]), (device, dtype));
    let gradients = (out.clone() * Tensor::from_inner(weights)).sum().backward();
    let host = |tensor: Tensor<1>| tensor.into_data().iter::<f64>().collect::<Vec<_>>();
    let of_leaves = leaves.iter().map(|leaf| leaf.grad(&gradients).map_or_else(Vec::new, host));
    std::iter::once(host(out)).chain(of_leaves.collect::<Vec<_>>()).collect()
}

/// Compares both forms: in f64 on a CPU, and in f32 everywhere, relative to the largest number of each output.
fn compare(name: &str, inputs: &[Vec<f64>], function: Function) {
    let on_cpu = [(Device::flex(), DType::F64, 1e-12)];
    for (device, dtype, tolerance) in on_cpu.into_iter().chain(devices().into_iter().map(|on| (on, DType::F32, 2e-5))) {
        let operation = found(function, inputs, &device, dtype);
        let tensors = in_tensor_code(|| found(function, inputs, &device, dtype));
        for (which, (a, b)) in operation.iter().zip(&tensors).enumerate() {
            assert_eq!(a.len(), b.len(), "{name}, {device:?}: numbers of output {which}");
            let largest = a.iter().fold(1e-30_f64, |largest, value| largest.max(value.abs()));
            for (a, b) in a.iter().zip(b) {
                let error = (a - b).abs();
                assert!(error <= tolerance * largest, "{name}, {device:?}, {dtype:?}, output {which}: {a} and {b}");
            }
        }
        assert!(operation[0].iter().any(|value| *value != 0.0), "{name}: nothing to compare");
    }
}

/// Numbers exact in f32.
fn numbers(random: &mut Random, count: usize, low: f64, high: f64) -> Vec<f64> {
    random.fill(count, low, high).iter().map(|value| f64::from(*value as f32)).collect()
}

#[test]
fn activations() {
    let (count, mut random) = (40, Random::new(1));
    let mut fill = |columns: usize, size: f64| numbers(&mut random, columns * count, -size, size);
    let mut inputs = [fill(3, 5.0), fill(4, 1.0), fill(3, 4.0), fill(1, 4.0), fill(12, 1.0)];
    // What the rule of usable Gaussians knows, one in each of the first rows.
    inputs[0][0] = 2e18;
    inputs[1][4..8].fill(0.0);
    inputs[2][6] = 89.0;
    inputs[2][9] = f64::NEG_INFINITY;
    inputs[3][4] = f64::NAN;
    inputs[4][12 * 5 + 3] = f64::INFINITY;
    inputs[3][6] = 0.0;
    compare("activation", &inputs, &|of| {
        let raw = RawSplats {
            means: shaped(&of[0], [count, 3]),
            rotations: shaped(&of[1], [count, 4]),
            log_scales: shaped(&of[2], [count, 3]),
            logit_opacities: of[3].clone(),
            sh: shaped(&of[4], [count, 4, 3]),
        };
        let (scales, opacities) = activated(&raw, None).unwrap();
        Tensor::cat(vec![scales.reshape([3 * count]), opacities], 0)
    });
    for device in devices() {
        for (value, expected) in [(1.0_f32, 0), (f32::NAN, 1), (f32::NEG_INFINITY, 1)] {
            let values = Tensor::<1>::from_floats([0.5, value, f32::MAX], &device).autodiff();
            assert_eq!(in_tensor_code(|| non_finite(&values)).into_scalar::<i32>(), expected, "{device:?}: {value}");
        }
    }
}

#[test]
fn environments() {
    let (height, width) = (5, 7);
    for degree in 0..=4 {
        let (coefficients, mut random) = ((degree + 1) * (degree + 1), Random::new(degree as u64));
        let mut directions = random.fill(3 * height * width, -1.0, 1.0);
        for pixel in 0..height * width {
            let along = [0, 1, 2].map(|axis| axis * height * width + pixel);
            let length = along.iter().map(|&at| directions[at] * directions[at]).sum::<f64>().sqrt();
            along.into_iter().for_each(|at| directions[at] /= length);
        }
        let inputs = [
            numbers(&mut random, 3 * height * width, 0.0, 1.0),
            numbers(&mut random, height * width, 0.0, 1.0),
            numbers(&mut random, 3 * coefficients, -0.5, 0.5),
        ];
        compare(&format!("environment of degree {degree}"), &inputs, &|of| {
            let data = TensorData::new(directions.clone(), [3, height, width]);
            let directions = Tensor::<3>::from_data(data, (&of[0].device(), of[0].dtype()));
            let image = shaped(&of[0], [3, height, width]).permute([1, 2, 0]);
            let alpha = shaped(&of[1], [height, width, 1]);
            over(&image, &alpha, &directions, &shaped(&of[2], [coefficients, 3])).unwrap().reshape([3 * height * width])
        });
    }
}

#[test]
fn bilateral_grids() {
    let ([height, width], [levels, rows, columns]) = ([6, 9], [4, 3, 5]);
    let mut random = Random::new(3);
    let mut image = random.fill(3 * height * width, -0.1, 1.1);
    for pixel in 0..height * width {
        // The slope jumps at the levels of the grid.
        let at = |channel: usize| 3 * pixel + channel;
        let level = (0..3).map(|channel| image[at(channel)] * LUMA[channel]).sum::<f64>() * (levels - 1) as f64;
        let away = level.round() + (level - level.round()).abs().clamp(0.1, 0.5).copysign(level - level.round());
        (0..3).for_each(|channel| image[at(channel)] += (away - level) / (levels - 1) as f64);
    }
    let grid = numbers(&mut random, 12 * levels * rows * columns, -1.0, 1.0);
    compare("bilateral grid", &[image, grid], &|of| {
        let mapped = slice(&shaped(&of[0], [height, width, 3]), &shaped(&of[1], [12, levels, rows, columns]));
        mapped.unwrap().reshape([3 * height * width])
    });
}

type Change = fn(&Projected, &Tensor<1>, f64) -> Result<Projected, SplatError>;

/// Ellipses of Gaussians in and around the picture, of which the last is behind the camera.
#[test]
fn motion_blur_and_rolling_shutters() {
    let (count, camera) = (24, Intrinsics { fy: 44.0, cx: 23.0, cy: 19.0, ..Intrinsics::centred(48, 36, 40.0) });
    let mut random = Random::new(4);
    let mut row = |i: usize| {
        let far = if i % 5 == 4 { 4.0 } else { 1.0 };
        let culled = i + 1 == count;
        let row = [
            24.0 + far * random.between(-30.0, 30.0),
            18.0 + far * random.between(-25.0, 25.0),
            random.between(-1.0, 1.5).exp(),
            random.between(-1.0, 1.0),
            random.between(-1.0, 1.5).exp(),
            random.between(1.0, 5.0),
            random.between(0.1, 0.9),
        ];
        row.map(|value| if culled { 0.0 } else { f64::from(value as f32) })
    };
    let rows: Vec<f64> = (0..count).flat_map(&mut row).collect();
    let twist = vec![0.125, -0.09375, 0.1875, 0.375, -0.3125, 0.125];
    let changes: [(&str, Change); 2] = [("motion blur", blurred), ("rolling shutter", rolled)];
    for (name, change) in changes {
        compare(name, &[rows.clone(), twist.clone()], &|of| {
            let projected = Projected::of(shaped(&of[0], [count, 7]), camera);
            change(&projected, &of[1], 0.3).unwrap().packed().clone().reshape([7 * count])
        });
    }
}

#[test]
fn sorts_are_equal_to_the_last_row() {
    for (device, count) in devices().into_iter().flat_map(|device| [0, 1, 2, 500].map(|count| (device.clone(), count)))
    {
        let mut keys: Vec<f32> = numbers(&mut Random::new(8), count, 0.0, 20.0).iter().map(|key| *key as f32).collect();
        // Many are equal.
        keys.iter_mut().step_by(2).for_each(|key| *key = key.floor());
        let whole: Vec<i32> = keys.iter().map(|key| *key as i32 * 100_000_000).collect();
        if count > 2 {
            (keys[3], keys[7], keys[4]) = (f32::NAN, f32::INFINITY, f32::NAN);
        }
        let whole = Tensor::<1, Int>::from_data(TensorData::new(whole, [count]), (&device, DType::I32));
        let keys = Tensor::<1>::from_data(TensorData::new(keys, [count]), &device);
        let sorted = || [argsort(whole.clone(), ALL_BITS), argsort_floats(keys.clone())].map(Tensor::into_data);
        assert_eq!(in_tensor_code(sorted), sorted(), "{count} keys, {device:?}");
    }
}

#[test]
fn it_ends_with_its_task_and_concerns_one_thread() {
    assert!(!is_tensor_code());
    in_tensor_code(|| {
        assert!(is_tensor_code() && in_tensor_code(is_tensor_code) && is_tensor_code());
        std::thread::spawn(|| assert!(!is_tensor_code())).join().unwrap();
    });
    assert!(!is_tensor_code());
    assert!(std::panic::catch_unwind(|| in_tensor_code(|| panic!("a task that fails"))).is_err());
    assert!(!is_tensor_code());
}
