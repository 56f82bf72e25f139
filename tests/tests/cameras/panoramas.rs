//! Cameras that see all directions, against the exact renderer, differences, and themselves after a turn.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DMat3, DVec2};
use splat_hard_cases::exact::ExactView;
use splat_op::{Equirectangular, Panorama, Projection, SplatError};

use super::gradients::{Inputs, check_gradients};
use super::*;

/// Centres in all directions, among them the poles, the seam, and edges and corners of the cube.
fn around(random: &mut Random, count: usize) -> Vec<DVec3> {
    let special = [
        DVec3::Y,
        -DVec3::Y,
        -DVec3::Z,
        DVec3::new(0.02, -1.0, 0.01),
        DVec3::new(1.0, 0.1, 1.0),
        DVec3::new(-1.0, 1.0, -1.0),
    ];
    let mut of = |low: f64, high: f64| random.between(low, high);
    let random = (0..count).map(|_| {
        loop {
            let at = DVec3::new(of(-1.0, 1.0), of(-1.0, 1.0), of(-1.0, 1.0));
            if at.length() > 0.2 && at.length() < 1.0 {
                return at.normalize() * of(1.5, 5.0);
            }
        }
    });
    special.into_iter().map(|at| 2.0 * at.normalize()).chain(random).collect()
}

/// The ray of a pixel's centre, by COLMAP's formula.
fn ray([x, y]: [usize; 2], [width, height]: [usize; 2]) -> DVec3 {
    let longitude = ((x as f64 + 0.5) / width as f64 - 0.5) * TAU;
    let latitude = (0.5 - (y as f64 + 0.5) / height as f64) * PI;
    DVec3::new(latitude.cos() * longitude.sin(), -latitude.sin(), latitude.cos() * longitude.cos())
}

/// A panorama by the exact renderer: each pixel at its position on the face that its ray meets, without resampling.
fn reference(
    of: &[ExactGaussian],
    pose: &DAffine3,
    panorama: &Panorama,
    size: [usize; 2],
    options: &RenderOptions,
) -> Vec<f64> {
    let at = f64s();
    let faces = panorama.faces(&pose_on(&DAffine3::IDENTITY, &at));
    let faces = faces.map(|face| {
        let rows = host(face.cam_from_world);
        let turn = DMat3::from_cols_array(&std::array::from_fn(|i| rows[4 * (i % 3) + i / 3]));
        assert!((turn.determinant() - 1.0).abs() < 1e-15 && rows[3] == 0.0 && rows[7] == 0.0 && rows[11] == 0.0);
        let seen = ExactPose { rotation: turn * pose.matrix3, translation: turn * pose.translation };
        (turn, face.intrinsics, ExactView::new(of, &seen, &face.intrinsics, options))
    });
    let pixels = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| [x, y]));
    let of_pixel = |pixel: [usize; 2]| {
        let ray = ray(pixel, size);
        let ahead = |(turn, ..): &&(DMat3, Intrinsics, ExactView)| (*turn * ray).z;
        let (turn, intrinsics, view) = faces.iter().max_by(|a, b| ahead(a).total_cmp(&ahead(b))).expect("six");
        let seen = *turn * ray;
        let px = intrinsics.px_from_cam(seen).expect("ahead");
        flat(&view.position(px, &[0.1, 0.8]), 1.0 / seen.z)
    };
    pixels.flat_map(of_pixel).collect()
}

fn with_background(at: &(Device, DType)) -> Extras {
    Extras::default().with_background(tensor(&[0.1, 0.8], [2], &at.0, at.1))
}

/// The only difference from the reference is the interpolation's, which falls with the square of the faces' side. The blur is that of the
/// coarsest faces.
#[test]
fn panoramas_approach_the_reference_as_faces_grow() {
    let mut random = Random::new(5);
    let centres = around(&mut random, 40);
    let (of, pose, size) = (gaussians(&mut random, &centres, 0.12), DAffine3::IDENTITY, [96, 48]);
    let at = f64s();
    for projection in [Projection::Affine, Projection::RayMax] {
        let errors = [1, 2, 4].map(|finer| {
            let side = finer * 31;
            let options = SMOOTH.with_projection(projection).with_blur(0.3 * f64::from(finer as u32).powi(2));
            let panorama = Panorama::with_faces(size[0], size[1], side, &at.0).expect("valid");
            let expected = reference(&of, &pose, &panorama, size, &options);
            let found = panorama.render(&splats(&of, &at), &pose_on(&pose, &at), &with_background(&at), &options);
            largest(&pixels(found.expect("valid")), &expected)
        });
        println!("{projection:?}: {errors:?}");
        assert!(errors[0] < 0.3, "{projection:?}: {errors:?}");
        for pair in errors.windows(2) {
            let ratio = pair[0] / pair[1];
            assert!(ratio > 3.2 && ratio < 5.0, "{projection:?}: {errors:?}");
        }
    }
}

#[test]
fn panoramas_agree_on_every_device() {
    let mut random = Random::new(6);
    let centres = around(&mut random, 40);
    let (of, pose) = (gaussians(&mut random, &centres, 0.1), turned());
    for projection in [Projection::Affine, Projection::RayMax] {
        let options = SMOOTH.with_projection(projection);
        let render = |at: &(Device, DType)| {
            let panorama = Panorama::new(70, 37, &at.0).expect("valid");
            let found = panorama.render(&splats(&of, at), &pose_on(&pose, at), &with_background(at), &options);
            pixels(found.expect("valid"))
        };
        let expected = render(&f64s());
        for at in everywhere() {
            let error = largest(&render(&at), &expected);
            assert!(error < if at.1 == DType::F64 { 1e-12 } else { 3e-4 }, "{projection:?}, {at:?}: {error}");
        }
    }
}

/// A quarter turn about the upright axis takes faces to faces, so the picture is the same to rounding, moved by a quarter of its width:
/// the seam is like any other place.
#[test]
fn the_seam_is_like_any_other_place() {
    let mut random = Random::new(7);
    let centres = around(&mut random, 40);
    let (of, at, size) = (gaussians(&mut random, &centres, 0.1), f64s(), [64, 32]);
    let panorama = Panorama::new(size[0], size[1], &at.0).expect("valid");
    let render = |pose: &DAffine3| {
        let found = panorama.render(&splats(&of, &at), &pose_on(pose, &at), &with_background(&at), &SMOOTH);
        pixels(found.expect("valid"))
    };
    let before = render(&turned());
    for quarters in 1..4 {
        let turn = DAffine3::from_rotation_y(FRAC_PI_2 * f64::from(quarters));
        let after = render(&(turn * turned()));
        // A turn about +y, which is down, moves what is ahead to the right.
        let moved: Vec<f64> = (0..size[1])
            .flat_map(|y| (0..size[0]).map(move |x| (y, (x + 64 - 16 * quarters as usize) % 64)))
            .flat_map(|(y, x)| before[4 * (64 * y + x)..4 * (64 * y + x) + 4].to_vec())
            .collect();
        let error = largest(&after, &moved);
        assert!(error < 1e-9, "{quarters} quarters: {error}");
    }
}

/// What is at a pole after a quarter turn about the x axis looks as it did at the equator. Pixels at the edges of the cube, across which a
/// Gaussian's ellipse changes, are not compared. What is left is the error of two interpolations.
#[test]
fn the_poles_are_like_any_other_place() {
    let mut random = Random::new(8);
    let centres = around(&mut random, 40);
    let (of, at, [width, height]) = (gaussians(&mut random, &centres, 0.15), f64s(), [256, 128]);
    let panorama = Panorama::new(width, height, &at.0).expect("valid");
    let render = |pose: &DAffine3| {
        let found = panorama.render(&splats(&of, &at), &pose_on(pose, &at), &with_background(&at), &SMOOTH);
        pixels(found.expect("valid"))
    };
    let turn = DMat3::from_rotation_x(FRAC_PI_2);
    let (before, after) = (render(&DAffine3::IDENTITY), render(&DAffine3::from_mat3(turn)));
    let value = |picture: &[f64], x: usize, y: usize, plane: usize| picture[4 * (width * y + x % width) + plane];
    let (mut compared, mut worst) = (0, 0.0_f64);
    for pixel in (0..height).flat_map(|y| (0..width).map(move |x| [x, y])) {
        let seen = ray(pixel, [width, height]);
        let px = Equirectangular { width, height }.px_from_cam(turn.transpose() * seen);
        let mut lengths = seen.abs().to_array();
        lengths.sort_by(f64::total_cmp);
        // The other picture is interpolated where its pixels are square.
        if (px.y / height as f64 - 0.5).abs() > 0.25 || lengths[1] > 0.9 * lengths[2] {
            continue;
        }
        let (corner, along) = ((px - 0.5).floor(), (px - 0.5) - (px - 0.5).floor());
        let (x, y) = ((corner.x as i64).rem_euclid(width as i64) as usize, corner.y as usize);
        for plane in 0..3 {
            let row =
                |y: usize| value(&before, x, y, plane) * (1.0 - along.x) + value(&before, x + 1, y, plane) * along.x;
            let expected = row(y) * (1.0 - along.y) + row(y + 1) * along.y;
            worst = worst.max((value(&after, pixel[0], pixel[1], plane) - expected).abs());
        }
        compared += 1;
    }
    println!("{worst} over {compared} pixels");
    assert!(compared > 15_000 && worst < 2e-2, "{worst} over {compared} pixels");
}

#[test]
fn gradients_of_panoramas_agree_with_differences() {
    let mut random = Random::new(10);
    let centres = around(&mut random, 4);
    let inputs = Inputs::new(&gaussians(&mut random, &centres, 0.15), &turned(), &mut random);
    let panorama = Panorama::new(20, 10, &Device::flex()).expect("valid");
    for projection in [Projection::Affine, Projection::RayMax] {
        check_gradients(&inputs, |splats, pose, extras| {
            panorama.render(splats, pose, extras, &SMOOTH.with_projection(projection)).expect("valid")
        });
    }
}

/// On a GPU the gradient is that of the CPU, and has the same bits in every run if gradients are added in order.
#[test]
fn gradients_of_panoramas_agree_on_every_device() {
    let mut random = Random::new(11);
    let centres = around(&mut random, 30);
    let of = gaussians(&mut random, &centres, 0.1);
    let options = SMOOTH.with_accumulation(splat_op::Accumulation::Ordered);
    let gradients = |(device, dtype): &(Device, DType)| {
        let at = (device.clone().autodiff(), *dtype);
        let given = splats(&of, &at);
        let (means, pose) = (given.means.clone().require_grad(), pose_on(&turned(), &at).require_grad());
        let panorama = Panorama::new(40, 20, &at.0).expect("valid");
        let found = panorama.render(&Splats { means: means.clone(), ..given }, &pose, &with_background(&at), &options);
        let planes = {
            let found = found.expect("valid");
            Tensor::cat(vec![found.colour, found.alpha, found.depth.expect("asked for")], 2)
        };
        let weights = Random::new(12).fill(40 * 20 * 4, -1.0, 1.0);
        let grads = (planes * tensor::<3>(&weights, [20, 40, 4], &at.0, at.1)).sum().backward();
        [host(means.grad(&grads).expect("tracked")), host(pose.grad(&grads).expect("tracked"))]
    };
    let expected = gradients(&f64s());
    for at in everywhere() {
        let found = gradients(&at);
        for (found, expected) in found.iter().zip(&expected) {
            let most = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            let error = largest(found, expected) / most;
            assert!(error < if at.1 == DType::F64 { 1e-10 } else { 1e-4 }, "{at:?}: {error}");
        }
        assert!(found == gradients(&at), "{at:?}");
    }
}

#[test]
fn positions_are_those_of_colmap() {
    let panorama = Equirectangular { width: 80, height: 40 };
    let places = [
        (DVec3::Z, [40.0, 20.0]),
        (DVec3::X, [60.0, 20.0]),
        (-DVec3::X, [20.0, 20.0]),
        (DVec3::new(0.0, -1.0, 1.0), [40.0, 10.0]),
        (DVec3::new(-1.0, 1.0, -1.0), [10.0, 20.0 + 40.0 / PI * (0.5_f64.sqrt()).atan()]),
    ];
    for (point, px) in places {
        let found = panorama.px_from_cam(3.0 * point);
        assert!(found.abs_diff_eq(DVec2::from_array(px), 1e-12), "{point}: {found}");
        assert!(panorama.cam_from_px(found).abs_diff_eq(point.normalize(), 1e-14), "{point}");
    }
    assert_eq!(panorama.px_from_cam(-DVec3::Y).y, 0.0);
    assert_eq!(panorama.px_from_cam(DVec3::Y).y, 40.0);
}

#[test]
fn panoramas_that_cannot_be_are_refused() {
    let device = Device::flex();
    for (made, field) in [
        (Panorama::new(0, 10, &device), "width"),
        (Panorama::new(10, 40_000, &device), "height"),
        (Panorama::with_faces(20, 10, 0, &device), "side"),
    ] {
        let refused = made.expect_err(field).to_string();
        assert!(refused.contains(field), "{refused}");
    }
    let (of, at) = (gaussians(&mut Random::new(1), &[DVec3::Z], 0.1), f64s());
    let (splats, pose) = (splats(&of, &at), pose_on(&DAffine3::IDENTITY, &at));
    let panorama = Panorama::new(20, 10, &device).expect("valid");
    let extras = Extras::default().with_backgrounds(tensor(&[0.0; 2], [1, 2], &at.0, at.1));
    let refused = panorama.render(&splats, &pose, &extras, &SMOOTH).expect_err("one background");
    assert!(matches!(refused, SplatError::Value { field: "backgrounds", .. }), "{refused}");
    let short = pose.clone().narrow(0, 0, 2);
    let refused = panorama.render(&splats, &short, &Extras::default(), &SMOOTH).expect_err("two rows");
    assert!(matches!(refused, SplatError::Shape { name: "cam_from_world", .. }), "{refused}");
    let elsewhere = Panorama::new(20, 10, &splat_tests::ndarray()).expect("valid");
    let refused = elsewhere.render(&splats, &pose, &Extras::default(), &SMOOTH).expect_err("another device");
    assert!(matches!(refused, SplatError::Device { name: "panorama", .. }), "{refused}");
}
