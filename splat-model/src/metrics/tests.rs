use burn::tensor::{Device, Distribution};

use super::*;

fn constant(value: f64) -> Tensor<3> {
    Tensor::full([12, 9, 3], value, &Device::flex())
}

#[test]
fn psnr_has_its_known_values() {
    assert!((psnr(constant(0.5), constant(0.6)) - 20.0).abs() < 1e-4);
    assert!((psnr(constant(0.0), constant(1.0)) - 0.0).abs() < 1e-6);
    assert_eq!(psnr(constant(0.3), constant(0.3)), LARGEST_PSNR_DB);
    assert!(psnr(constant(f64::NAN), constant(0.3)).is_nan());
}

#[test]
fn pictures_are_clamped_before_they_are_compared() {
    assert_eq!(psnr(constant(7.0), constant(1.0)), LARGEST_PSNR_DB);
    assert!((psnr(constant(-3.0), constant(0.1)) - 20.0).abs() < 1e-4);
    assert!((ssim(constant(7.0), constant(1.0)) - 1.0).abs() < 1e-6);
}

#[test]
fn ssim_is_that_of_the_loss() {
    let random = || Tensor::<3>::random([20, 17, 3], Distribution::Uniform(0.0, 1.0), &Device::flex());
    let (image, truth) = (random(), random());
    let expected: f64 = crate::loss::ssim(image.clone(), truth.clone()).into_scalar();
    assert!((ssim(image.clone(), truth) - expected).abs() < 1e-6);
    assert!((ssim(image.clone(), image) - 1.0).abs() < 1e-6);
}

#[test]
fn views_count_equally() {
    assert_eq!(mean_over_views(&[20.0, 30.0]), 25.0);
    assert!(mean_over_views(&[]).is_nan());
}
