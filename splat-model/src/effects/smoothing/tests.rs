use super::*;
use crate::gaussians::testing::random_rows;

fn cameras() -> Vec<(Intrinsics, DAffine3)> {
    let camera = |focal_px: f64, distance: f64| {
        (Intrinsics::centred(40, 30, focal_px), DAffine3::from_translation(DVec3::new(0.0, 0.0, distance)))
    };
    vec![camera(50.0, 5.0), camera(20.0, 1.0), camera(50.0, 40.0)]
}

fn smoothing(cameras: &[(Intrinsics, DAffine3)]) -> Smoothing {
    Smoothing::new(cameras.iter().map(|(intrinsics, pose)| (intrinsics, pose)))
}

#[test]
fn the_finest_photograph_that_shows_a_centre_counts() {
    let smoothing = smoothing(&cameras());
    let rate = |mean: [f32; 3]| (0.5 * VARIANCE.ln() - f64::from(smoothing.ln_widths(&[mean])[0])).exp();
    // At the origin: 50/5 = 10, 20/1 = 20, 50/40.
    assert!((rate([0.0; 3]) - 20.0).abs() < 1e-4);
    // At x = 2 the near camera does not see the point: its slopes end at 1.3, margin included.
    assert!((rate([2.0, 0.0, 0.0]) - 10.0).abs() < 1e-4);
    // Behind the first two.
    assert!((rate([0.0, 0.0, -20.0]) - 2.5).abs() < 1e-4);
    // A point that no camera sees gets the coarsest filter of the others.
    let widths = smoothing.ln_widths(&[[0.0; 3], [0.0, 0.0, -50.0], [2.0, 0.0, 0.0]]);
    assert_eq!(widths[1], widths[2]);
    assert!(smoothing.ln_widths(&[[0.0, 0.0, -50.0]])[0].is_finite());
}

#[test]
fn variances_add_and_the_integral_stays() {
    let device = Device::flex();
    let log_scales = [[-3.0_f32, -1.0, 0.5], [-60.0, -2.0, 80.0], [-9.0, -9.0, -9.0]];
    let ln_widths = [-1.5_f32, -2.0, -30.0];
    let widths = Tensor::<1>::from_floats(ln_widths.as_slice(), &device).unsqueeze_dim::<2>(1);
    let (found, share) = convolved(Tensor::<2>::from_floats(log_scales, &device).exp(), widths.exp());
    let (found, share) = (values_of(found.log()), values_of(share.log()));
    for (i, scales) in log_scales.iter().enumerate() {
        let mut expected_share = 0.0;
        for (j, &scale) in scales.iter().enumerate() {
            let (scale, width) = (f64::from(scale), f64::from(ln_widths[i]));
            let expected = 0.5 * ((2.0 * scale).exp() + (2.0 * width).exp()).ln();
            assert!(
                (f64::from(found[3 * i + j]) - expected).abs() < 1e-5 * expected.abs().max(1.0),
                "{i} {j}: {}",
                found[3 * i + j]
            );
            expected_share += scale - expected;
        }
        assert!(
            (f64::from(share[i]) - expected_share).abs() < 2e-5 * expected_share.abs().max(1.0),
            "{i}: {}",
            share[i]
        );
    }
}

/// The determinant of 10⁻¹² scene units would be 10⁻⁷², which is 0 in f32, and its ratio 0 / 0.
#[test]
fn tiny_gaussians_keep_their_share() {
    let device = Device::flex();
    let tiny = 1e-12_f32.ln();
    let widths = Tensor::<2>::from_floats([[tiny.exp()]], &device);
    let log_scales = Tensor::<2>::full([1, 3], tiny, &device.clone().autodiff()).require_grad();
    let (_, share) = convolved(log_scales.clone().exp(), Tensor::from_inner(widths));
    assert!((share.clone().inner().into_scalar::<f32>() - 0.5_f32.powf(1.5)).abs() < 1e-5);
    // d ln share / d ln σ = Σ 1/(1 + σ²/g²), a half each.
    let gradient = values_of(log_scales.grad(&share.log().sum().backward()).unwrap());
    assert!(gradient.iter().all(|value| (value - 0.5).abs() < 1e-6), "{gradient:?}");
}

#[test]
fn what_is_unusable_stays_so_and_spoils_no_gradient() {
    let device = Device::flex();
    let mut rows = random_rows(3, 0, 5);
    rows.log_scales[1] = [f32::NAN, 0.0, f32::INFINITY];
    let smoothing_of = |gaussians: &Gaussians| {
        let mut smoothing = smoothing(&cameras());
        smoothing.follow(gaussians, 1);
        smoothing
    };
    let gaussians = Gaussians::from_rows(&rows, &device.clone().autodiff()).unwrap();
    let splats = smoothing_of(&gaussians).apply(gaussians.splats());
    assert_eq!(values_of(splats.opacities.clone().inner())[1], 0.0);
    let loss = splats.opacities.sum() + splats.scales.sum();
    let gradients = loss.backward();
    let gradient = values_of(gaussians.log_scales.val().grad(&gradients).unwrap());
    assert!(gradient.iter().all(|value| value.is_finite()), "{gradient:?}");
    assert!(gradient[3] == 0.0 && gradient[5] == 0.0 && gradient[0] != 0.0, "{gradient:?}");
    let mut baked = rows.clone();
    smoothing_of(&gaussians).bake(&mut baked);
    assert_eq!(baked.logit_opacities[1], rows.logit_opacities[1]);
}

/// Other viewers show the file as it was trained.
#[test]
fn a_baked_scene_is_the_smoothed_one() {
    let device = Device::flex();
    let mut rows = random_rows(20, 1, 8);
    rows.logit_opacities[0] = 40.0;
    rows.logit_opacities[1] = -90.0;
    let gaussians = Gaussians::from_rows(&rows, &device).unwrap();
    let mut smoothing = smoothing(&cameras());
    smoothing.follow(&gaussians, 1);
    let smoothed = smoothing.apply(gaussians.splats());
    smoothing.bake(&mut rows);
    let baked = Gaussians::from_rows(&rows, &device).unwrap().splats();
    let near = |a: Vec<f32>, b: Vec<f32>, what: &str| {
        for (a, b) in a.into_iter().zip(b) {
            assert!((a - b).abs() <= 3e-5 * b.abs(), "{what}: {a} and {b}");
        }
    };
    near(values_of(smoothed.scales), values_of(baked.scales), "scales");
    near(values_of(smoothed.opacities), values_of(baked.opacities), "opacities");
}

#[test]
fn the_filter_follows_the_scene() {
    let device = Device::flex();
    let mut smoothing = smoothing(&cameras());
    let scene = |count| Gaussians::from_rows(&random_rows(count, 0, 5), &device).unwrap();
    smoothing.follow(&scene(3), 1);
    let widths = |smoothing: &Smoothing| values_of(smoothing.ln_widths.clone().unwrap());
    let first = widths(&smoothing);
    let mut moved = random_rows(3, 0, 5);
    moved.means.iter_mut().for_each(|mean| mean[2] += 3.0);
    let moved = Gaussians::from_rows(&moved, &device).unwrap();
    smoothing.follow(&moved, EVERY);
    assert_eq!(widths(&smoothing), first);
    smoothing.follow(&moved, EVERY + 1);
    assert_ne!(widths(&smoothing), first);
    smoothing.forget_rows();
    smoothing.follow(&scene(5), EVERY + 2);
    assert_eq!((widths(&smoothing).len(), smoothing.bytes()), (5, 20));
}
