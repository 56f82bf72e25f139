use burn::tensor::{DType, Device, Tensor, TensorData};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::in_tensor_code;

use super::regularise;
use super::*;
use crate::gaussians::values_of;

/// A picture on the host, `[H, W, C]` row-major.
#[derive(Clone)]
struct HostPicture {
    shape: [usize; 3],
    values: Vec<f64>,
}

impl HostPicture {
    fn random(shape: [usize; 3], seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Self { shape, values: (0..shape.iter().product()).map(|_| rng.random_range(0.0..1.0)).collect() }
    }

    fn constant(shape: [usize; 3], value: f64) -> Self {
        Self { shape, values: vec![value; shape.iter().product()] }
    }

    fn tensor(&self, device: &Device, dtype: DType) -> Tensor<3> {
        Tensor::from_data(TensorData::new(self.values.clone(), self.shape), (device, dtype))
    }

    /// The value at a pixel; zero outside the picture, like the padding.
    fn at(&self, y: isize, x: isize, c: usize) -> f64 {
        let [height, width, channels] = self.shape;
        if y < 0 || x < 0 || y >= height as isize || x >= width as isize {
            return 0.0;
        }
        self.values[(y as usize * width + x as usize) * channels + c]
    }
}

/// SSIM at every pixel by its definition: a double loop over the 11 × 11 window that computes all moments in one pass.
fn reference_map(a: &HostPicture, b: &HostPicture) -> Vec<f64> {
    let total: f64 = (-5..=5).map(|d: isize| (-((d * d) as f64) / 4.5).exp()).sum();
    let [height, width, channels] = a.shape;
    let mut map = Vec::new();
    for y in 0..height as isize {
        for x in 0..width as isize {
            for c in 0..channels {
                let (mut ma, mut mb, mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0, 0.0, 0.0);
                for dy in -5..=5isize {
                    for dx in -5..=5isize {
                        let weight = (-((dx * dx + dy * dy) as f64) / 4.5).exp() / (total * total);
                        let (p, q) = (a.at(y + dy, x + dx, c), b.at(y + dy, x + dx, c));
                        ma += weight * p;
                        mb += weight * q;
                        aa += weight * p * p;
                        bb += weight * q * q;
                        ab += weight * p * q;
                    }
                }
                let luminance = (2.0 * ma * mb + 0.0001) / (ma * ma + mb * mb + 0.0001);
                let structure = (2.0 * (ab - ma * mb) + 0.0009) / (aa - ma * ma + bb - mb * mb + 0.0009);
                map.push(luminance * structure);
            }
        }
    }
    map
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().iter::<f64>().collect()
}

/// Value and gradient of a loss of one picture, in the order of the picture.
fn differentiate(image: Tensor<3>, loss: impl Fn(Tensor<3>) -> Tensor<1>) -> (f64, Vec<f64>) {
    let variable = image.autodiff().require_grad();
    let value = loss(variable.clone());
    let mut gradients = value.backward();
    let gradient = variable.grad_remove(&mut gradients).expect("the loss depends on its image");
    (host(value)[0], host(gradient))
}

fn devices() -> [Device; 2] {
    [Device::flex(), ndarray()]
}

#[expect(deprecated, reason = "NdArray is the second CPU backend that the project supports")]
fn ndarray() -> Device {
    Device::ndarray()
}

/// Odd sizes, one the size of the window, some smaller than it.
const SHAPES: [[usize; 3]; 5] = [[37, 53, 3], [11, 11, 3], [5, 7, 3], [1, 1, 3], [13, 4, 1]];

#[test]
fn ssim_is_its_definition() {
    for device in devices() {
        for (dtype, tolerance) in [(DType::F64, 1e-12), (DType::F32, 2e-5)] {
            for (seed, shape) in SHAPES.into_iter().enumerate() {
                let (a, b) = (HostPicture::random(shape, seed as u64), HostPicture::random(shape, 100 + seed as u64));
                let expected = reference_map(&a, &b);
                let (image, truth) = (a.tensor(&device, dtype), b.tensor(&device, dtype));
                let found = host(ssim_map(image.clone(), truth.clone()));
                for (found, expected) in found.iter().zip(&expected) {
                    let error = (found - expected).abs();
                    assert!(error <= tolerance, "{shape:?} {dtype:?}: {found} instead of {expected}");
                }
                let expected = mean(&expected);
                let fast = 1.0 - host(d_ssim(image.clone(), &Truth::new(truth.clone())))[0];
                let plain = host(ssim(image, truth))[0];
                assert!((fast - expected).abs() <= tolerance, "{shape:?} {dtype:?}: {fast} instead of {expected}");
                assert!((plain - expected).abs() <= tolerance, "{shape:?} {dtype:?}: {plain} instead of {expected}");
            }
        }
    }
}

#[test]
fn photometric_mixes_both_terms_and_tracking_changes_no_value() {
    let device = Device::flex();
    for shape in SHAPES {
        let (a, b) = (HostPicture::random(shape, 1), HostPicture::random(shape, 2));
        let truth = Truth::new(b.tensor(&device, DType::F64));
        let absolute: Vec<f64> = a.values.iter().zip(&b.values).map(|(a, b)| (a - b).abs()).collect();
        let expected = 0.7 * mean(&absolute) + 0.3 * (1.0 - mean(&reference_map(&a, &b)));
        let image = a.tensor(&device, DType::F64);
        let untracked = host(photometric(image.clone(), &truth, 0.3))[0];
        let (tracked, _) = differentiate(image, |image| photometric(image, &truth, 0.3));
        assert!((untracked - expected).abs() <= 1e-12, "{shape:?}: {untracked} instead of {expected}");
        assert_eq!(tracked, untracked);
    }
}

/// Central differences of `value` at every `stride`-th element against `gradient`.
fn assert_gradient(picture: &HostPicture, gradient: &[f64], stride: usize, value: impl Fn(&HostPicture) -> f64) {
    let largest = gradient.iter().fold(0.0f64, |largest, g| largest.max(g.abs()));
    assert!(largest > 0.0);
    for i in (0..gradient.len()).step_by(stride) {
        let at = |offset: f64| {
            let mut moved = picture.clone();
            moved.values[i] += offset;
            value(&moved)
        };
        let expected = (at(1e-5) - at(-1e-5)) / 2e-5;
        let error = (gradient[i] - expected).abs();
        assert!(error <= 1e-6 * largest, "element {i}: {} instead of {expected}", gradient[i]);
    }
}

#[test]
fn gradients_are_those_of_finite_differences() {
    for device in devices() {
        for (shape, stride) in SHAPES.into_iter().zip([401, 7, 1, 1, 3]) {
            let (a, b) = (HostPicture::random(shape, 3), HostPicture::random(shape, 4));
            let truth = Truth::new(b.tensor(&device, DType::F64));
            let tensor = |picture: &HostPicture| picture.tensor(&device, DType::F64);

            let (_, gradient) = differentiate(tensor(&a), |image| d_ssim(image, &truth));
            assert_gradient(&a, &gradient, stride, |moved| 1.0 - mean(&reference_map(moved, &b)));

            let (_, gradient) = differentiate(tensor(&a), |image| photometric(image, &truth, DEFAULT_LAMBDA));
            assert_gradient(&a, &gradient, stride, |moved| {
                let absolute: Vec<f64> = moved.values.iter().zip(&b.values).map(|(a, b)| (a - b).abs()).collect();
                0.8 * mean(&absolute) + 0.2 * (1.0 - mean(&reference_map(moved, &b)))
            });

            let in_tensors = || {
                let truth = Truth::new(tensor(&b));
                differentiate(tensor(&a), |image| photometric(image, &truth, DEFAULT_LAMBDA)).1
            };
            for (plain, closed) in in_tensor_code(in_tensors).iter().zip(&gradient) {
                assert!((plain - closed).abs() <= 1e-12, "{plain} in tensor code, {closed} in closed form");
            }

            // Compares with autodiff of the plain formulation, under an incoming gradient other than 1.
            let (_, plain) = differentiate(tensor(&a), |image| ssim(image, tensor(&b)) * -3.0);
            let (_, closed) = differentiate(tensor(&a), |image| d_ssim(image, &truth) * 3.0);
            for (plain, closed) in plain.iter().zip(&closed) {
                assert!((plain - closed).abs() <= 1e-12, "{plain} by autodiff, {closed} in closed form");
            }
        }
    }
}

#[test]
fn f32_gradients_agree_with_f64() {
    let (a, b) = (HostPicture::random([37, 53, 3], 5), HostPicture::random([37, 53, 3], 6));
    let gradient = |dtype| {
        let truth = Truth::new(b.tensor(&Device::flex(), dtype));
        differentiate(a.tensor(&Device::flex(), dtype), |image| photometric(image, &truth, 1.0)).1
    };
    let (narrow, wide) = (gradient(DType::F32), gradient(DType::F64));
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let error = norm(&mut narrow.iter().zip(&wide).map(|(n, w)| n - w));
    let length = norm(&mut wide.iter().copied());
    assert!(error <= 1e-4 * length, "relative error {}", error / length);
}

#[test]
fn flat_pictures_equal_themselves_and_have_finite_gradients() {
    let shape = [23, 31, 3];
    let flat = [0.0, 1.0, 0.5, 1e-20].map(|value| HostPicture::constant(shape, value));
    for device in devices() {
        for a in &flat {
            for b in &flat {
                let truth = Truth::new(b.tensor(&device, DType::F32));
                let image = a.tensor(&device, DType::F32);
                let (value, gradient) = differentiate(image, |image| photometric(image, &truth, DEFAULT_LAMBDA));
                assert!(gradient.iter().all(|g| g.is_finite()));
                if a.values == b.values {
                    assert!(value.abs() <= 1e-6, "{value} for {}", a.values[0]);
                    // At the optimum only rounding is left, beside an L1 gradient of 1/N elsewhere.
                    let largest = gradient.iter().fold(0.0f64, |largest, g| largest.max(g.abs()));
                    assert!(largest <= 0.02 / gradient.len() as f64, "gradient {largest} for {}", a.values[0]);
                } else {
                    assert!(value.is_finite());
                }
            }
        }
    }
}

#[test]
fn truth_gives_its_photograph_back() {
    let picture = HostPicture::random([4, 6, 3], 8);
    for device in devices() {
        let truth = Truth::new(picture.tensor(&device, DType::F64));
        assert_eq!(host(truth.image()), picture.values);
    }
}

#[test]
fn l1_is_the_mean_absolute_error() {
    let device = Device::flex();
    let tensor = |values: [f32; 4]| Tensor::<3>::from_data(TensorData::new(values.to_vec(), [1, 2, 2]), &device);
    let (image, truth) = (tensor([0.0, 1.0, 0.5, 0.5]), tensor([1.0, 0.5, 0.5, 0.75]));
    let (value, gradient) = differentiate(image, |image| l1(image, truth.clone()));
    assert_eq!(value, 0.4375);
    assert_eq!(gradient, [-0.25, 0.25, 0.0, -0.25]);
}

#[test]
fn all_gaussians_have_equal_shares_of_a_mean() {
    for device in crate::gaussians::testing::devices() {
        let opacities = Tensor::<1>::full([5_003], 0.5, &device).autodiff().require_grad();
        let loss = regularise::opacity(opacities.clone());
        let shares = values_of(opacities.grad(&loss.backward()).expect("tracked"));
        assert!((values_of(loss.inner())[0] - 0.5).abs() < 1e-6);
        assert!(shares.len() == 5_003 && shares.iter().all(|share| (share * 5_003.0 - 1.0).abs() < 1e-6));
    }
}

#[test]
fn regularisers_have_their_values_and_bounded_gradients() {
    let device = Device::flex();
    let opacities = Tensor::<1>::from_data([0.25, 0.75], &device);
    assert_eq!(host(regularise::opacity(opacities)), [0.5]);
    let scales = Tensor::<2>::from_data([[1.0, 2.0, 3.0]], &device);
    assert_eq!(host(regularise::scale(scales)), [2.0]);

    // Of no Gaussians there is nothing to penalise.
    assert_eq!(host(regularise::opacity(Tensor::<1>::zeros([0], &device))), [0.0]);
    assert_eq!(host(regularise::scale(Tensor::zeros([0, 3], &device))), [0.0]);
    assert_eq!(host(regularise::needles(Tensor::zeros([0, 3], &device), 10.0)), [0.0]);

    let logs = Tensor::<2>::from_data([[50.0, 0.0, -50.0], [0.0, 1.0, 2.0]], &device).autodiff().require_grad();
    let loss = regularise::needles(logs.clone(), 10.0);
    assert!((host(loss.clone())[0] - (100.0 - 10f64.ln()) / 2.0).abs() < 1e-5);
    let gradient = logs.grad_remove(&mut loss.backward()).expect("the loss depends on the scales");
    assert_eq!(host(gradient), [0.5, 0.0, -0.5, 0.0, 0.0, 0.0]);
}
