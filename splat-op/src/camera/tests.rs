//! Lenses on the host: values of COLMAP's formulas evaluated independently, round trips, and domains.

use glam::{DVec2, DVec3};

use super::lens::positive_roots;
use super::*;
use crate::testing::lenses::{FOX, lenses};
use crate::testing::random::Random;

fn camera((model, distortion): (CameraModel, [f64; 8])) -> Intrinsics {
    let plain = Intrinsics::pinhole(400, 300, [300.0, 310.0], [205.0, 148.0]);
    plain.with_lens(model, distortion)
}

#[test]
fn points_are_seen_where_colmaps_formulas_have_them() {
    let point = DVec3::new(0.6, -0.45, 1.25);
    for (lens, expected) in lenses().into_iter().zip(PUBLISHED) {
        let found = camera(lens).px_from_cam(point).unwrap();
        assert!(found.abs_diff_eq(DVec2::from_array(expected), 1e-10), "{lens:?}: {found} {expected:?}");
    }
}

#[test]
fn a_position_on_the_picture_and_back() {
    let mut random = Random::new(1);
    for lens in lenses() {
        let camera = camera(lens);
        for _ in 0..300 {
            let px = DVec2::new(random.between(0.0, 400.0), random.between(0.0, 300.0));
            let ray = camera.cam_from_px(px);
            let again = camera.px_from_cam(3.0 * ray).unwrap();
            assert!(again.abs_diff_eq(px, 1e-9), "{lens:?}: {px} {ray} {again}");
            let unit = if lens.0.is_fisheye() { ray.length() } else { ray.z };
            assert!((unit - 1.0).abs() < 1e-14, "{lens:?}: {ray}");
        }
    }
    let pinhole = camera((CameraModel::Pinhole, [0.0; 8]));
    assert_eq!(pinhole.cam_from_px(DVec2::new(505.0, -7.0)), DVec3::new(1.0, -0.5, 1.0));
}

/// A position without a direction gets the nearest direction in the lens's domain, and never one that is not finite.
#[test]
fn positions_that_no_direction_leads_to_are_survived() {
    let strong =
        |k: [f64; 8]| [(CameraModel::OpenCv, k), (CameraModel::FullOpenCv, k), (CameraModel::ThinPrismFisheye, k)];
    let wild = [[-9.0, 0.0, 0.0, 0.0], [1e9, -1e9, 1e9, -1e9], [0.0, 0.0, 50.0, 3.0], [-1e9, 1e9, 0.0, 0.0]];
    for [a, b, c, d] in wild {
        for (model, mut distortion) in strong([a, b, c, d, b, a, d, c]) {
            distortion[model.coefficients()..].fill(0.0);
            let camera = camera((model, distortion));
            assert!(camera.check().is_ok() && camera.max_radius() > 0.0);
            for px in [DVec2::ZERO, DVec2::new(205.0, 148.0), DVec2::new(400.0, 20.0)] {
                assert!(camera.cam_from_px(px).is_finite(), "{camera:?}");
            }
            for [low, high] in camera.slope_limits(0.3) {
                assert!(low <= 0.0 && high >= 0.0 && low.is_finite() && high.is_finite(), "{camera:?}");
            }
        }
    }
}

/// Within the domain no two directions project to one position. At its rim the radial derivative vanishes if the lens has no
/// decentring.
#[test]
fn the_reach_is_where_a_lens_turns_round() {
    let radial = |k1: f64, k2: f64| camera((CameraModel::OpenCv, [k1, k2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])).max_radius();
    // 1 + 3 k1 w + 5 k2 w² = 0
    assert!((radial(-1.0 / 3.0, 0.0) - 1.0).abs() < 1e-15);
    assert!((radial(0.1, -0.2) - ((0.3 + 4.09_f64.sqrt()) / 2.0).sqrt()).abs() < 1e-15);
    assert_eq!([radial(0.0, 0.0), radial(0.3, 0.2), radial(-0.12, 0.03)], [f64::INFINITY; 3]);
    // Decentring makes the domain smaller.
    let fox = camera(FOX).max_radius();
    assert!(fox < radial(FOX.1[0], FOX.1[1]) && fox > 1.33, "{fox}");
    // A denominator of zero: 1 − w/4.
    let mut distortion = [0.0; 8];
    distortion[5] = -0.25;
    assert!((camera((CameraModel::FullOpenCv, distortion)).max_radius() - 2.0).abs() < 1e-12);
    // θ (1 − θ²/3)
    distortion = [-1.0 / 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert!((camera((CameraModel::Fisheye, distortion)).max_radius() - 1.0).abs() < 1e-15);
}

#[test]
fn two_directions_within_reach_never_meet() {
    let mut random = Random::new(2);
    let decentred = (CameraModel::OpenCv, [-0.2, 0.02, 0.05, -0.08, 0.0, 0.0, 0.0, 0.0]);
    for lens in lenses().into_iter().chain([decentred]) {
        let camera = camera(lens);
        let max_radius = camera.max_radius().min(if lens.0.is_fisheye() { 1.5 } else { 4.0 });
        let mut place = || loop {
            let s = DVec2::new(random.between(-max_radius, max_radius), random.between(-max_radius, max_radius));
            if s.length() < max_radius {
                let point = if lens.0.is_fisheye() { s * (s.length().tan() / s.length()) } else { s };
                return (s, camera.px_from_cam(point.extend(1.0)).unwrap());
            }
        };
        for _ in 0..2_000 {
            let ((a, a_px), (b, b_px)) = (place(), place());
            // The map is strongly monotonic there, which implies one to one.
            let displaced = (a_px - b_px) / DVec2::new(camera.fx, camera.fy);
            assert!(displaced.dot(a - b) > 0.0, "{lens:?}: {a} and {b}");
        }
    }
}

#[test]
fn roots_are_found_in_order() {
    // (r − 1)(r − 2)(r + 3)(r² + 1)
    assert_eq!(positive_roots(&[6.0, -7.0, 6.0, -6.0, 0.0, 1.0]).len(), 2);
    let roots = positive_roots(&[6.0, -7.0, 6.0, -6.0, 0.0, 1.0]);
    assert!((roots[0] - 1.0).abs() < 1e-14 && (roots[1] - 2.0).abs() < 1e-14, "{roots:?}");
    assert!(
        positive_roots(&[]).is_empty() && positive_roots(&[0.0, 0.0]).is_empty() && positive_roots(&[3.0]).is_empty()
    );
    assert!(positive_roots(&[1.0, 1.0]).is_empty());
}

#[test]
fn coefficients_that_mean_nothing_are_refused() {
    let refused = |model, at: usize, value: f64| {
        let mut distortion = [0.0; 8];
        distortion[at] = value;
        let error = camera((model, distortion)).check().unwrap_err().to_string();
        assert!(error.contains("`distortion`"), "{error}");
    };
    refused(CameraModel::OpenCv, 0, f64::NAN);
    refused(CameraModel::FullOpenCv, 7, f64::INFINITY);
    refused(CameraModel::Fisheye, 3, -1.1e9);
    refused(CameraModel::Pinhole, 0, 0.1);
    refused(CameraModel::OpenCv, 4, 0.1);
    lenses().into_iter().for_each(|lens| camera(lens).check().unwrap());
}

#[test]
fn another_size_keeps_the_lens() {
    let (full, small) = (camera(FOX), camera(FOX).resized(200, 100));
    let point = DVec3::new(0.3, -0.2, 1.0);
    let (full, small) = (full.px_from_cam(point).unwrap(), small.px_from_cam(point).unwrap());
    assert!(small.abs_diff_eq(full / DVec2::new(2.0, 3.0), 1e-12));
}

/// Positions by the formulas of COLMAP's `models.h` in 30 digits (mpmath), for [`lenses`] in order.
const PUBLISHED: [[f64; 2]; 6] = [
    [350.460_027_980_8, 35.167_703_514_88],
    [341.446_912, 42.197_843_2],
    [340.063_704_741_441_03, 43.325_628_825_383_205],
    [334.700_680_064_940_2, 47.481_972_949_671_345],
    [336.402_877_143_853_9, 46.162_770_213_513_2],
    [334.573_811_198_309_2, 47.625_564_572_932_61],
];
