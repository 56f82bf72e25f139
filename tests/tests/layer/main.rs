//! What users of other rasterizers expect of the layer: planes and radii that cull, backgrounds and sizes for each camera, radii,
//! expected depth, normals, contributors, median depth and masks of tiles, on every device.

mod contributors;
mod masks;

use burn::tensor::{Bool, DType, Device, Tensor};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use splat_hard_cases::exact::{ExactGaussian, ExactPose, render_exact};
use splat_op::{
    Camera, Colour, Extras, Intrinsics, Projection, RenderOptions, SplatError, Splats, normals, project, render,
    render_each, render_view,
};
use splat_tests::random::Random;
use splat_tests::scene::{host, tensor};
use splat_tests::{cpu_devices, gpu};

const CAMERA: Intrinsics = Intrinsics::centred(48, 32, 40.0);

const OPTIONS: RenderOptions = RenderOptions::exact().with_depth(true).with_far(5.0).with_radius_clip(4.0);

/// Every device with its float types: both on the CPU, f32 on the GPU.
fn everywhere() -> Vec<(Device, DType)> {
    let cpus = cpu_devices().into_iter().flat_map(|(_, device)| [DType::F32, DType::F64].map(|t| (device.clone(), t)));
    cpus.chain(gpu().map(|device| (device, DType::F32))).collect()
}

/// Gaussians of one to ten pixels, two to eight units away, over a picture of two channels.
fn gaussians(count: usize) -> Vec<ExactGaussian> {
    let mut random = Random::new(7);
    let mut of = |low: f64, high: f64| f64::from(random.between(low, high) as f32);
    (0..count)
        .map(|_| {
            let (depth, size) = (of(2.0, 8.0), of(-4.0, -1.5).exp());
            ExactGaussian {
                mean: DVec3::new(of(-0.5, 0.5) * depth, of(-0.3, 0.3) * depth, depth),
                rotation: [of(-1.0, 1.0), of(-1.0, 1.0), of(-1.0, 1.0), of(0.1, 1.0)],
                scale: DVec3::new(size, size * of(0.3, 1.0), size * of(0.3, 1.0)),
                opacity: of(0.2, 0.9),
                features: vec![of(0.0, 1.0), of(0.0, 1.0)],
            }
        })
        .collect()
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

fn camera(intrinsics: Intrinsics, (device, dtype): &(Device, DType)) -> Camera {
    let camera = Camera::new(intrinsics, &DAffine3::IDENTITY, device);
    Camera { cam_from_world: camera.cam_from_world.cast(*dtype), ..camera }
}

#[test]
fn far_plane_and_radii_cull_as_in_the_reference() {
    let of = gaussians(60);
    let pose = ExactPose { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    for projection in [Projection::Affine, Projection::RayMax] {
        let options = OPTIONS.with_projection(projection).with_expected_depth(true);
        let count = |options: &RenderOptions| {
            let sum =
                |pixels: Vec<splat_hard_cases::exact::ExactPixel>| pixels.iter().map(|pixel| pixel.alpha).sum::<f64>();
            sum(render_exact(&of, &pose, &CAMERA, &[0.0; 2], options))
        };
        let all = options.with_far(f64::INFINITY).with_radius_clip(0.0);
        assert!(count(&options) < 0.9 * count(&options.with_radius_clip(0.0)), "no Gaussian is small");
        assert!(count(&options.with_radius_clip(0.0)) < 0.9 * count(&all), "no Gaussian is far");
        let expected = render_exact(&of, &pose, &CAMERA, &[0.0; 2], &options);
        for at in everywhere() {
            let found =
                render_view(&splats(&of, &at), &camera(CAMERA, &at), &Extras::default(), &options).expect("valid");
            let (colour, alpha) = (host(found.colour.clone()), host(found.alpha.clone()));
            let depth = host(found.expected_depth.expect("asked for"));
            for (i, pixel) in expected.iter().enumerate() {
                let what = format!("{projection:?}, {at:?}, pixel {i}");
                assert!((alpha[i] - pixel.alpha).abs() < 2e-5, "{what}: alpha {} {}", alpha[i], pixel.alpha);
                for (channel, value) in pixel.features.iter().enumerate() {
                    assert!((colour[2 * i + channel] - value).abs() < 2e-5, "{what}: channel {channel}");
                }
                let mean = pixel.depth / pixel.alpha;
                assert!(pixel.alpha < 1e-2 || (depth[i] / mean - 1.0).abs() < 1e-3, "{what}: {} {mean}", depth[i]);
            }
        }
    }
}

#[test]
fn radii_are_three_deviations_of_what_is_visible() {
    let of = gaussians(60);
    for at in everywhere() {
        let options = OPTIONS.with_radius_clip(0.0);
        let of_all = project(&splats(&of, &at), &camera(CAMERA, &at), &Extras::default(), &options).expect("valid");
        let (radii, visible) = (host(of_all.radii()), flags(of_all.visible()));
        let ellipses = of_all.ellipses();
        let [u, shear, v] = [ellipses.sigma_u, ellipses.shear, ellipses.sigma_v].map(host);
        let clipped = project(&splats(&of, &at), &camera(CAMERA, &at), &Extras::default(), &OPTIONS).expect("valid");
        let kept = flags(clipped.visible());
        assert!(visible.iter().any(|seen| *seen) && visible.iter().any(|seen| !*seen));
        for (i, gaussian) in of.iter().enumerate() {
            assert_eq!(visible[i], gaussian.mean.z < 5.0, "{at:?}, {i}");
            let expected = if visible[i] { [3.0 * u[i], 3.0 * (shear[i] * u[i]).hypot(v[i])] } else { [0.0; 2] };
            for axis in 0..2 {
                assert!((radii[2 * i + axis] - expected[axis]).abs() <= 1e-5 * expected[axis], "{at:?}, {i}");
            }
            let largest = expected[0].max(expected[1]);
            assert!((largest - 4.0).abs() < 1e-4 || kept[i] == (largest > 4.0), "{at:?}, {i}: {largest}");
        }
    }
}

fn flags(mask: Tensor<1, Bool>) -> Vec<bool> {
    mask.into_data().iter::<bool>().collect()
}

#[test]
fn cameras_have_backgrounds_and_sizes_of_their_own() {
    let of = gaussians(20);
    for at in everywhere() {
        let splats = splats(&of, &at);
        let views = [CAMERA, Intrinsics::centred(20, 30, 25.0)].map(|intrinsics| camera(intrinsics, &at));
        let rows = [[0.2, 0.4], [0.9, 0.1]];
        let extras = Extras::default().with_backgrounds(tensor(rows.as_flattened(), [2, 2], &at.0, at.1));
        let found = render_each(&splats, &views, &extras, &OPTIONS).expect("valid");
        for ((found, view), row) in found.iter().zip(&views).zip(rows) {
            let own = Extras::default().with_background(tensor(&row, [2], &at.0, at.1));
            let expected = render_view(&splats, view, &own, &OPTIONS).expect("valid");
            assert!(host(found.colour.clone()) == host(expected.colour), "{at:?}");
        }
        let of_one_size = render(&splats, &[views[0].clone(), views[0].clone()], &extras, &OPTIONS).expect("valid");
        assert!(host(of_one_size.colour)[..2 * 48 * 32] == host(found[0].colour.clone())[..], "{at:?}");
        let refused = render_each(&splats, &views[..1], &extras, &OPTIONS).expect_err("two rows for one camera");
        assert!(matches!(refused, SplatError::Shape { name: "backgrounds", .. }), "{refused}");
        let refused = render_view(&splats, &views[0], &extras, &OPTIONS).expect_err("one camera");
        assert!(refused.to_string().contains("`backgrounds`"), "{refused}");
    }
}

#[test]
fn what_is_asked_for_is_there_and_nothing_else() {
    let of = gaussians(40);
    for (projection, at) in
        everywhere().into_iter().flat_map(|at| [Projection::Affine, Projection::RayMax].map(|p| (p, at.clone())))
    {
        let (splats, view) = (splats(&of, &at), camera(CAMERA, &at));
        let options = OPTIONS.with_depth(false).with_projection(projection);
        let extras = Extras::default().with_background(tensor(&[0.3, 0.6], [2], &at.0, at.1));
        let none = render_view(&splats, &view, &extras, &options).expect("valid");
        assert!(none.depth.is_none() && none.expected_depth.is_none() && none.normals.is_none());
        assert!(none.radii.is_none() && none.visible.is_none());

        let asked = options.with_expected_depth(true).with_normals(true).with_radii(true).with_visible(true);
        let found = render(&splats, &[view.clone(), view.clone()], &extras, &asked).expect("valid");
        assert!(found.depth.is_none() && found.colour.dims() == [2, 32, 48, 2]);
        let twice = |values: Vec<f64>| [values.clone(), values].concat();
        assert!(host(found.colour) == twice(host(none.colour)), "{projection:?}, {at:?}");
        let projected = project(&splats, &view, &extras, &options).expect("valid");
        assert!(host(found.radii.expect("asked for")) == twice(host(projected.radii())), "{projection:?}, {at:?}");
        let visible: Vec<bool> = found.visible.expect("asked for").into_data().iter::<bool>().collect();
        assert_eq!(visible, [flags(projected.visible()), flags(projected.visible())].concat());
        // Normals are features over black.
        let turned = Colour::Features(normals(&splats, &view).expect("valid"));
        let of_normals = Splats { colour: turned, ..splats.clone() };
        let expected = render_view(&of_normals, &view, &Extras::default(), &options).expect("valid").colour;
        let normals = host(found.normals.expect("asked for"));
        for (found, expected) in normals.iter().zip(twice(host(expected))) {
            assert!((found - expected).abs() < 1e-6, "{projection:?}, {at:?}: {found} instead of {expected}");
        }
    }
}

#[test]
fn normals_of_a_render_have_gradients() {
    let (at, plain) = ((Device::flex().autodiff(), DType::F64), (Device::flex(), DType::F64));
    let of = gaussians(12);
    let gradient = |render: &dyn Fn(Splats) -> Tensor<3>| {
        let rotations = splats(&of, &at).rotations.require_grad();
        let picture = render(Splats { rotations: rotations.clone(), ..splats(&of, &plain) });
        let weights = Random::new(3).fill(32 * 48 * 3, -1.0, 1.0);
        let loss = (picture * tensor::<3>(&weights, [32, 48, 3], &at.0, at.1)).sum();
        host(rotations.grad(&loss.backward()).expect("tracked"))
    };
    let view = camera(CAMERA, &plain);
    let found = gradient(&|splats| {
        let rendered = render_view(&splats, &view, &Extras::default(), &OPTIONS.with_normals(true)).expect("valid");
        rendered.normals.expect("asked for")
    });
    let expected = gradient(&|splats| {
        let colour = Colour::Features(normals(&splats, &view).expect("valid"));
        render_view(&Splats { colour, ..splats }, &view, &Extras::default(), &OPTIONS).expect("valid").colour
    });
    assert!(expected.iter().any(|value| value.abs() > 1e-3));
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
    }
}

/// The shortest axis in f64, turned towards a camera.
fn normal(gaussian: &ExactGaussian, rotation: [f64; 4], eye: DVec3) -> DVec3 {
    let [w, x, y, z] = rotation;
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let scale = gaussian.scale.to_array();
    let shortest = (0..3).min_by(|a, b| scale[*a].total_cmp(&scale[*b])).expect("three");
    let axis = axes.col(shortest);
    if axis.dot(gaussian.mean - eye) > 0.0 { -axis } else { axis }
}

#[test]
fn normals_are_shortest_axes_that_face_the_camera() {
    let mut of = gaussians(50);
    of[0].rotation = [0.0; 4];
    of[1].rotation = of[1].rotation.map(|c| c * 1e25);
    let pose = DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.4), DVec3::new(0.3, -0.2, 0.5));
    let eye = pose.inverse().translation;
    for at in everywhere() {
        let view = Camera::new(CAMERA, &pose, &at.0);
        let view = Camera { cam_from_world: view.cam_from_world.cast(at.1), ..view };
        let found = host(normals(&splats(&of, &at), &view).expect("valid"));
        assert!(found.iter().all(|value| value.is_finite()), "{at:?}");
        for (i, gaussian) in of.iter().enumerate().skip(1) {
            let expected = normal(gaussian, gaussian.rotation, eye);
            let found = DVec3::from_slice(&found[3 * i..3 * i + 3]);
            assert!(found.distance(expected) < 1e-5, "{at:?}, {i}: {found} instead of {expected}");
        }
    }
}

#[test]
fn normals_have_the_gradients_of_differences() {
    let mut of = gaussians(12);
    of[5].rotation = [0.0; 4];
    // Constants stay on the device without autodiff.
    let (at, plain) = ((Device::flex().autodiff(), DType::F64), (Device::flex(), DType::F64));
    let mut given = splats(&of, &plain);
    given.rotations = splats(&of, &at).rotations.require_grad();
    let weights = Random::new(3).fill(36, -1.0, 1.0);
    let found = normals(&given, &camera(CAMERA, &plain)).expect("valid");
    let gradients = (found * tensor::<2>(&weights, [12, 3], &at.0, at.1)).sum().backward();
    let found = host(given.rotations.grad(&gradients).expect("tracked"));
    for (i, gaussian) in of.iter().enumerate() {
        let weight = DVec3::from_slice(&weights[3 * i..3 * i + 3]);
        for component in 0..4 {
            let moved = |step: f64| {
                let mut rotation = gaussian.rotation;
                rotation[component] += step;
                normal(gaussian, rotation, DVec3::ZERO).dot(weight)
            };
            let expected = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            let found = found[4 * i + component];
            // A zero quaternion has no gradient.
            let expected = if i == 5 { 0.0 } else { expected };
            assert!((found - expected).abs() < 1e-6, "{i}, {component}: {found} instead of {expected}");
        }
    }
}
