//! Cameras with parallel rays and cameras that see all directions, against the exact renderer, differences and each other.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use burn::tensor::{DType, Device, Tensor};
use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use splat_op::exact::{ExactGaussian, ExactPixel, ExactPose, ExactView, render_exact};
use splat_op::sh::harmonics;
use splat_op::{
    Camera, CameraModel, Colour, Extras, Intrinsics, Panorama, Projection, RenderOptions, SplatError, Splats,
    evaluate_sh, normals, render_view,
};
use splat_tests::random::Random;
use splat_tests::scene::{host, tensor};
use splat_tests::{cpu_devices, gpu};

/// No cuts, so that renders are continuous.
const SMOOTH: RenderOptions = RenderOptions::exact().with_alpha_min(0.0).with_depth(true);

fn f64s() -> (Device, DType) {
    (Device::flex(), DType::F64)
}

/// Every device with its float types: both on the CPU, f32 on the GPU.
fn everywhere() -> Vec<(Device, DType)> {
    let cpus = cpu_devices().into_iter().flat_map(|(_, device)| [DType::F32, DType::F64].map(|t| (device.clone(), t)));
    cpus.chain(gpu().map(|device| (device, DType::F32))).collect()
}

/// A camera of 8 px per scene unit.
fn orthographic() -> Intrinsics {
    let mut camera = Intrinsics::centred(40, 28, 8.0);
    camera.model = CameraModel::Orthographic;
    (camera.fy, camera.cx) = (7.0, 18.0);
    camera
}

fn turned() -> DAffine3 {
    let rotation = DQuat::from_xyzw(0.2, -0.15, 0.1, 0.9).normalize();
    DAffine3::from_rotation_translation(rotation, DVec3::new(0.2, -0.1, 0.3))
}

fn pose_of(pose: &DAffine3) -> ExactPose {
    ExactPose { rotation: pose.matrix3, translation: pose.translation }
}

fn pose_rows(pose: &DAffine3) -> Vec<f64> {
    let (m, t) = (pose.matrix3, pose.translation);
    (0..3).flat_map(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]).collect()
}

/// Gaussians whose centres are given, of `size` times their distance from the origin, with two features.
fn gaussians(random: &mut Random, centres: &[DVec3], size: f64) -> Vec<ExactGaussian> {
    let mut of = |low: f64, high: f64| f64::from(random.between(low, high) as f32);
    let centres = centres.iter().map(|centre| centre.as_vec3().as_dvec3());
    let gaussian = |mean: DVec3| ExactGaussian {
        mean,
        rotation: [of(-1.0, 1.0), of(-1.0, 1.0), of(-1.0, 1.0), of(0.1, 1.0)],
        scale: DVec3::new(of(0.6, 1.0), of(0.6, 1.0), of(0.6, 1.0)) * f64::from((size * mean.length()) as f32),
        opacity: of(0.3, 0.9),
        features: vec![of(0.0, 1.0), of(0.0, 1.0)],
    };
    centres.map(gaussian).collect()
}

fn splats(of: &[ExactGaussian], (device, dtype): &(Device, DType)) -> Splats {
    let flat = |each: &dyn Fn(&ExactGaussian) -> Vec<f64>| of.iter().flat_map(each).collect::<Vec<f64>>();
    let n = of.len();
    Splats {
        means: tensor(&flat(&|g| g.mean.to_array().to_vec()), [n, 3], device, *dtype),
        rotations: tensor(&flat(&|g| g.rotation.to_vec()), [n, 4], device, *dtype),
        scales: tensor(&flat(&|g| g.scale.to_array().to_vec()), [n, 3], device, *dtype),
        opacities: tensor(&flat(&|g| vec![g.opacity]), [n], device, *dtype),
        colour: Colour::Features(tensor(&flat(&|g| g.features.clone()), [n, 2], device, *dtype)),
    }
}

fn pose_on(pose: &DAffine3, (device, dtype): &(Device, DType)) -> Tensor<2> {
    tensor(&pose_rows(pose), [3, 4], device, *dtype)
}

fn camera(intrinsics: Intrinsics, pose: &DAffine3, at: &(Device, DType)) -> Camera {
    Camera { intrinsics, cam_from_world: pose_on(pose, at) }
}

/// Channels of a picture, then alpha and depth, pixel by pixel.
fn pixels(of: splat_op::Rendered<3>) -> Vec<f64> {
    host(Tensor::cat(vec![of.colour, of.alpha, of.depth.expect("asked for")], 2))
}

fn flat(pixel: &ExactPixel, length: f64) -> [f64; 4] {
    [pixel.features[0], pixel.features[1], pixel.alpha, pixel.depth * length]
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    // `max` drops NaN.
    assert!(a.iter().chain(b).all(|value| value.is_finite()));
    a.iter().zip(b).fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

fn before_a_wall(random: &mut Random, count: usize) -> Vec<DVec3> {
    let pose = turned().inverse();
    let mut of = |low: f64, high: f64| random.between(low, high);
    (0..count).map(|_| pose.transform_point3(DVec3::new(of(-3.0, 3.0), of(-2.0, 2.0), of(0.5, 9.0)))).collect()
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
            let extras = Extras { background: Some(tensor(&background, [2], &at.0, at.1)), ..Extras::default() };
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

/// Values of a scene's tensors, in the order of [`Self::NAMES`].
#[derive(Clone)]
struct Inputs {
    values: [Vec<f64>; 7],
    colour_shape: [usize; 3],
}

impl Inputs {
    const NAMES: [&str; 7] = ["means", "rotations", "scales", "opacities", "harmonics", "pose", "background"];

    fn new(of: &[ExactGaussian], pose: &DAffine3, random: &mut Random) -> Self {
        let at = f64s();
        let Splats { means, rotations, scales, opacities, .. } = splats(of, &at);
        let harmonics = random.fill(of.len() * 12, -0.4, 0.4);
        let background = vec![0.2, 0.5, 0.7];
        let values =
            [host(means), host(rotations), host(scales), host(opacities), harmonics, pose_rows(pose), background];
        Self { values, colour_shape: [of.len(), 4, 3] }
    }

    fn tensors(&self, device: &Device) -> (Splats, Tensor<3>, Tensor<2>, Extras) {
        let n = self.colour_shape[0];
        let leaf = |i: usize, width: usize| {
            let tensor: Tensor<2> = tensor(&self.values[i], [self.values[i].len() / width, width], device, DType::F64);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        let harmonics: Tensor<3> = tensor(&self.values[4], self.colour_shape, device, DType::F64);
        let harmonics = if device.is_autodiff() { harmonics.require_grad() } else { harmonics };
        let row = |i: usize, count: usize| {
            let tensor: Tensor<1> = tensor(&self.values[i], [count], device, DType::F64);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        let splats = Splats {
            means: leaf(0, 3),
            rotations: leaf(1, 4),
            scales: leaf(2, 3),
            opacities: row(3, n),
            colour: Colour::SphericalHarmonics(harmonics.clone()),
        };
        (splats, harmonics, leaf(5, 4), Extras { background: Some(row(6, 3)), ..Extras::default() })
    }
}

/// Compares gradients of a loss over pictures of `channels` planes with differences of the fourth order.
fn check_gradients(inputs: &Inputs, render: impl Fn(&Splats, &Tensor<2>, &Extras) -> splat_op::Rendered<3>) {
    let loss = |inputs: &Inputs, device: &Device| {
        let (splats, harmonics, pose, extras) = inputs.tensors(device);
        let found = render(&splats, &pose, &extras);
        let planes: Tensor<3> = Tensor::cat(vec![found.colour, found.alpha, found.depth.expect("asked for")], 2);
        let weights = Random::new(9).fill(planes.dims().iter().product(), -1.0, 1.0);
        let weights: Tensor<3> = tensor(&weights, planes.dims(), device, DType::F64);
        ((planes * weights).sum(), splats, harmonics, pose, extras)
    };
    let (value, splats, harmonics, pose, extras) = loss(inputs, &Device::flex().autodiff());
    let grads = value.backward();
    let background = extras.background.expect("given");
    let found = [
        host(splats.means.grad(&grads).expect("tracked")),
        host(splats.rotations.grad(&grads).expect("tracked")),
        host(splats.scales.grad(&grads).expect("tracked")),
        host(splats.opacities.grad(&grads).expect("tracked")),
        host(harmonics.grad(&grads).expect("tracked")),
        host(pose.grad(&grads).expect("tracked")),
        host(background.grad(&grads).expect("tracked")),
    ];
    for (input, found) in found.iter().enumerate() {
        let most = found.iter().fold(1e-3_f64, |most, value| most.max(value.abs()));
        for (i, found) in found.iter().enumerate() {
            let step = 1e-4 * inputs.values[input][i].abs().max(0.1);
            let at = |steps: f64| {
                let mut moved = inputs.clone();
                moved.values[input][i] += steps * step;
                host(loss(&moved, &Device::flex()).0)[0]
            };
            let expected = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step);
            let error = (found - expected).abs();
            assert!(error <= 2e-6 * most, "{}[{i}]: {found} instead of {expected}", Inputs::NAMES[input]);
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

/// Centres in all directions, among them the poles, the seam, and edges and corners of the cube.
fn around(random: &mut Random, count: usize) -> Vec<DVec3> {
    let special =
        [DVec3::Y, -DVec3::Y, -DVec3::Z, DVec3::new(0.02, -1.0, 0.01), DVec3::new(1.0, 0.1, 1.0), DVec3::new(-1.0, 1.0, -1.0)];
    let mut of = |low: f64, high: f64| random.between(low, high);
    let random = (0..count).map(|_| loop {
        let at = DVec3::new(of(-1.0, 1.0), of(-1.0, 1.0), of(-1.0, 1.0));
        if at.length() > 0.2 && at.length() < 1.0 {
            return at.normalize() * of(1.5, 5.0);
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
    Extras { background: Some(tensor(&[0.1, 0.8], [2], &at.0, at.1)), ..Extras::default() }
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
        assert!(errors[0] < 0.15, "{projection:?}: {errors:?}");
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

/// What is at a pole after a quarter turn about the x axis looks as it did at the equator.
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
        let px = panorama.px_from_cam(turn.transpose() * ray(pixel, [width, height]));
        // The other picture is interpolated where its pixels are square.
        if (px.y / height as f64 - 0.5).abs() > 0.25 {
            continue;
        }
        let (corner, along) = ((px - 0.5).floor(), (px - 0.5) - (px - 0.5).floor());
        let (x, y) = ((corner.x as i64).rem_euclid(width as i64) as usize, corner.y as usize);
        for plane in 0..3 {
            let row = |y: usize| value(&before, x, y, plane) * (1.0 - along.x) + value(&before, x + 1, y, plane) * along.x;
            let expected = row(y) * (1.0 - along.y) + row(y + 1) * along.y;
            worst = worst.max((value(&after, pixel[0], pixel[1], plane) - expected).abs());
        }
        compared += 1;
    }
    println!("{worst} over {compared} pixels");
    assert!(compared > 15_000 && worst < 5e-3, "{worst} over {compared} pixels");
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
    let panorama = Panorama::new(80, 40, &Device::flex()).expect("valid");
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
    let extras = Extras { backgrounds: Some(tensor(&[0.0; 2], [1, 2], &at.0, at.1)), ..Extras::default() };
    let refused = panorama.render(&splats, &pose, &extras, &SMOOTH).expect_err("one background");
    assert!(matches!(refused, SplatError::Value { field: "backgrounds", .. }), "{refused}");
    let short = pose.clone().narrow(0, 0, 2);
    let refused = panorama.render(&splats, &short, &Extras::default(), &SMOOTH).expect_err("two rows");
    assert!(matches!(refused, SplatError::Shape { name: "cam_from_world", .. }), "{refused}");
    let elsewhere = Panorama::new(20, 10, &splat_tests::ndarray()).expect("valid");
    let refused = elsewhere.render(&splats, &pose, &Extras::default(), &SMOOTH).expect_err("another device");
    assert!(matches!(refused, SplatError::Device { name: "panorama", .. }), "{refused}");
}
