//! Cameras with parallel rays, against the exact renderer and differences.

use burn::tensor::DType;
use glam::DVec3;
use splat_hard_cases::exact::render_exact;
use splat_op::sh::harmonics;
use splat_op::{Camera, CameraModel, Extras, Intrinsics, Projection, SplatError, evaluate_sh, normals, render_view};
use splat_tests::random::Random;
use splat_tests::scene::{host, tensor};

use super::gradients::{Inputs, check_gradients};
use super::*;

/// A camera of 8 px per scene unit.
fn orthographic() -> Intrinsics {
    let mut camera = Intrinsics::centred(40, 28, 8.0);
    camera.model = CameraModel::Orthographic;
    (camera.fy, camera.cx) = (7.0, 18.0);
    camera
}

#[test]
fn orthographic_pictures_are_those_of_the_reference() {
    let mut random = Random::new(1);
    let centres = before_a_wall(&mut random, 50);
    let of = gaussians(&mut random, &centres, 0.06);
    let (pose, intrinsics) = (turned(), orthographic());
    let background = [0.3, 0.6];
    for antialias in [false, true] {
        let options = SMOOTH.with_far(7.0).with_radius_clip(4.0).with_antialias(antialias);
        let expected = render_exact(&of, &pose_of(&pose), &intrinsics, &background, &options);
        let all = render_exact(&of, &pose_of(&pose), &intrinsics, &background, &SMOOTH.with_antialias(antialias));
        assert!(expected.iter().zip(&all).any(|(a, b)| (a.alpha - b.alpha).abs() > 0.1), "nothing is far or small");
        let expected: Vec<f64> = expected.iter().flat_map(|pixel| flat(pixel, 1.0)).collect();
        for at in everywhere() {
            let extras = Extras::default().with_background(tensor(&background, [2], &at.0, at.1));
            let found = render_view(&splats(&of, &at), &camera(intrinsics, &pose, &at), &extras, &options);
            let error = largest(&pixels(found.expect("valid")), &expected);
            assert!(error < if at.1 == DType::F64 { 1e-10 } else { 1e-4 }, "{at:?}: {error}");
        }
    }
}

/// Along parallel rays the largest value of a Gaussian is its ellipse's, so that one projection serves for both.
#[test]
fn the_largest_value_along_a_parallel_ray_is_the_ellipse() {
    let mut random = Random::new(2);
    let centres = before_a_wall(&mut random, 30);
    let (of, pose) = (gaussians(&mut random, &centres, 0.2), turned());
    let render = |projection| {
        let options = SMOOTH.with_projection(projection);
        let pixels = render_exact(&of, &pose_of(&pose), &orthographic(), &[0.0; 2], &options);
        pixels.iter().flat_map(|pixel| flat(pixel, 0.0)).collect::<Vec<f64>>()
    };
    let error = largest(&render(Projection::Affine), &render(Projection::RayMax));
    assert!(error < 1e-12, "{error}");
    let at = f64s();
    let options = SMOOTH.with_projection(Projection::RayMax);
    let view = camera(orthographic(), &pose, &at);
    let refused = render_view(&splats(&of, &at), &view, &Extras::default(), &options).expect_err("parallel rays");
    assert!(matches!(refused, SplatError::Value { field: "projection", .. }), "{refused}");
}

#[test]
fn parallel_rays_share_a_direction() {
    let mut random = Random::new(3);
    let centres = before_a_wall(&mut random, 9);
    let (of, pose) = (gaussians(&mut random, &centres, 0.1), turned());
    let coefficients = random.fill(9 * 9 * 3, -0.5, 0.5);
    let direction = pose.matrix3.transpose() * DVec3::Z;
    let basis = harmonics(direction.to_array(), 2);
    for at in everywhere() {
        let view = camera(orthographic(), &pose, &at);
        let sh = tensor(&coefficients, [9, 9, 3], &at.0, at.1);
        let of = splats(&of, &at);
        let found = host(evaluate_sh(&sh, &of.means, &view).expect("valid"));
        for (i, found) in found.iter().enumerate() {
            let row = &coefficients[27 * (i / 3)..27 * (i / 3 + 1)];
            let sum: f64 = (0..9).map(|k| basis[k] * row[3 * k + i % 3]).sum();
            assert!((found - (sum + 0.5).max(0.0)).abs() < 1e-5, "{at:?}, {i}: {found}");
        }
        for normal in host(normals(&of, &view).expect("valid")).chunks_exact(3) {
            assert!(DVec3::from_slice(normal).dot(direction) <= 0.0, "{at:?}: {normal:?} looks away");
        }
    }
}

#[test]
fn gradients_along_parallel_rays_agree_with_differences() {
    let mut random = Random::new(4);
    let centres = before_a_wall(&mut random, 8);
    let inputs = Inputs::new(&gaussians(&mut random, &centres, 0.15), &turned(), &mut random);
    check_gradients(&inputs, |splats, pose, extras| {
        let view = Camera { intrinsics: orthographic(), cam_from_world: pose.clone() };
        render_view(splats, &view, extras, &SMOOTH).expect("valid")
    });
}
