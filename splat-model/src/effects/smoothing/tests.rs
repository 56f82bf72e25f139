use glam::{DVec3, Vec3};
use splat_op::CameraModel;

use super::*;
use crate::gaussians::testing::{devices, random_rows};

fn cameras() -> Vec<(Intrinsics, DAffine3)> {
    let camera = |focal_px: f64, distance: f64| {
        (Intrinsics::centred(40, 30, focal_px), DAffine3::from_translation(DVec3::new(0.0, 0.0, distance)))
    };
    vec![camera(50.0, 5.0), camera(20.0, 1.0), camera(50.0, 40.0)]
}

fn smoothing(cameras: &[(Intrinsics, DAffine3)]) -> Smoothing {
    Smoothing::new(cameras.iter().map(|(intrinsics, pose)| (intrinsics, pose)))
}

fn ln_widths(smoothing: &Smoothing, means: &[[f32; 3]], device: &Device) -> Vec<f32> {
    let means = Tensor::<1>::from_floats(means.as_flattened(), device).reshape([means.len(), 3]);
    values_of(smoothing.ln_widths(&means))
}

#[test]
fn the_finest_photograph_that_shows_a_centre_counts() {
    let smoothing = smoothing(&cameras());
    let widths = |means: &[[f32; 3]]| ln_widths(&smoothing, means, &Device::flex());
    let rate = |mean: [f32; 3]| (0.5 * VARIANCE.ln() - f64::from(widths(&[mean])[0])).exp();
    // At the origin: 50/5 = 10, 20/1 = 20, 50/40.
    assert!((rate([0.0; 3]) - 20.0).abs() < 1e-4);
    // At x = 2 the near camera does not see the point: its slopes end at 1.3, margin included.
    assert!((rate([2.0, 0.0, 0.0]) - 10.0).abs() < 1e-4);
    // Behind the first two.
    assert!((rate([0.0, 0.0, -20.0]) - 2.5).abs() < 1e-4);
    // A point that no camera sees gets the coarsest filter of the others.
    let found = widths(&[[0.0; 3], [0.0, 0.0, -50.0], [2.0, 0.0, 0.0]]);
    assert_eq!(found[1], found[2]);
    assert!(widths(&[[0.0, 0.0, -50.0]])[0].is_finite() && widths(&[]).is_empty());
}

/// The formula of the module's head, on the host in f64, on every device and through every kind of lens.
#[test]
fn rates_are_those_of_the_photographs() {
    let mut rows = random_rows(400, 0, 9);
    rows.means.as_flattened_mut().iter_mut().for_each(|x| *x *= 2.5);
    let lens = |model, distortion: [f64; 4]| {
        let mut camera = Intrinsics::pinhole(40, 30, [25.0, 28.0], [18.0, 15.0]);
        camera.model = model;
        camera.distortion[..4].copy_from_slice(&distortion);
        camera
    };
    let all = [
        lens(CameraModel::Pinhole, [0.0; 4]),
        lens(CameraModel::OpenCv, [0.1, -0.05, 0.002, -0.001]),
        lens(CameraModel::Fisheye, [0.05, -0.01, 0.0, 0.0]),
    ];
    let pose = |i: usize| DAffine3::from_translation(DVec3::new(0.3 * i as f64, 0.1, 1.0 + i as f64));
    let cameras: Vec<_> = all.into_iter().enumerate().map(|(i, camera)| (camera, pose(i))).collect();
    let rate = |mean: &[f32; 3], (camera, pose): &(Intrinsics, DAffine3)| {
        let cam = pose.transform_point3(Vec3::from(*mean).as_dvec3());
        let inside = |px: f64, size: usize| (px / size as f64 - 0.5).abs() <= 0.5 + f64::from(MARGIN);
        let shown = camera.px_from_cam(cam).is_some_and(|px| inside(px.x, camera.width) && inside(px.y, camera.height));
        if shown { (camera.fx * camera.fy).sqrt() / cam.z } else { 0.0 }
    };
    for device in devices() {
        for seen in cameras.iter().map(std::slice::from_ref).chain([&cameras[..]]) {
            let means = Gaussians::from_rows(&rows, &device).unwrap().means();
            let found = values_of(smoothing(seen).rates(&means));
            let mut unseen = 0;
            for (mean, found) in rows.means.iter().zip(found) {
                let expected = seen.iter().map(|camera| rate(mean, camera)).fold(0.0, f64::max);
                assert!((f64::from(found) - expected).abs() <= 1e-5 * expected, "{found}, {expected} at {mean:?}");
                unseen += usize::from(expected == 0.0);
            }
            assert!((1..400).contains(&unseen), "{unseen} of 400 are not seen");
        }
    }
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
    let gradient = values_of(gaussians.log_scales().grad(&gradients).unwrap());
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
    let widths = |smoothing: &Smoothing| values_of(smoothing.widths.clone().unwrap()[0].clone());
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
    assert_eq!(widths(&smoothing).len(), 5);
}
