//! Compares the composed operation with Burn's autodiff of a dense tensor formulation, in f64 on Flex.

use burn::tensor::{DType, Device, Gradients, Tensor};
use splat_op::{
    CameraModel, Ellipses, Extras, Intrinsics, RenderOptions, Splats, intersect, project, rasterize, render,
};
use splat_tests::compare::relative_error;
use splat_tests::dense::{self, DenseEllipses};
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host, tensor};

/// Both sides compute in f64 and differ only by rounding.
const TOLERANCE: f64 = 1e-11;

const CAMERA: Intrinsics = Intrinsics::pinhole(20, 13, [17.0, 19.0], [8.5, 7.25]);
const FISHEYE: Intrinsics = CAMERA.with_lens(CameraModel::Fisheye, [0.0; 8]);

fn options(antialias: bool) -> RenderOptions {
    let smooth = RenderOptions::exact().with_alpha_min(0.0).with_transmittance_min(0.0).with_alpha_max(0.9);
    smooth.with_depth(true).with_antialias(antialias)
}

/// A scene with Gaussians inside, at and beyond the Jacobian's limits, some of them opaque and some tiny.
fn scene(seed: u64, camera: Intrinsics) -> Scene {
    let mut random = Random::new(seed);
    let mut scene = Scene::random(&mut random, 12, 2, camera);
    scene.opacities[0] = 1.0;
    scene.opacities[5] = 0.97;
    scene.means[3] = 4.0;
    scene.means[7] = -5.0;
    scene.scales[3..6].fill(2.0);
    scene.scales[6..9].fill(1.5);
    // Far smaller than a pixel: in an anti-aliased render, the compensation is at its floor.
    scene.scales[9..12].fill(1e-4);
    scene
}

fn assert_same(what: &str, found: &[f64], expected: &[f64]) {
    let error = relative_error(found, expected);
    assert!(error <= TOLERANCE, "{what}: relative error {error:.3e}");
    assert!(expected.iter().any(|e| *e != 0.0), "{what}: all zero, which proves nothing");
}

struct Pictures {
    colour: Vec<f64>,
    alpha: Vec<f64>,
    depth: Vec<f64>,
}

/// Computes the loss `Σ w·out` with the same random weights on both sides, and the values of the pictures.
fn loss<const D: usize>(colour: Tensor<D>, alpha: Tensor<D>, depth: Tensor<D>) -> (Tensor<1>, Pictures) {
    let mut random = Random::new(99);
    let mut weighted = |t: &Tensor<D>| {
        let shape = t.dims();
        let weights = random.fill(shape.iter().product(), -1.0, 1.0);
        (t.clone() * tensor(&weights, shape, &t.device(), DType::F64)).sum()
    };
    let sum = weighted(&colour) + weighted(&alpha) + weighted(&depth);
    (sum, Pictures { colour: host(colour), alpha: host(alpha), depth: host(depth) })
}

/// Returns the gradients of a scene's leaves, by name. A leaf on which the loss does not depend has no gradient.
fn gradients(leaves: &SceneTensors, grads: &Gradients) -> Vec<(&'static str, Vec<f64>)> {
    let Splats { means, rotations, scales, opacities, .. } = &leaves.splats;
    vec![
        ("means", host(means.grad(grads).expect("tracked"))),
        ("rotations", host(rotations.grad(grads).expect("tracked"))),
        ("scales", host(scales.grad(grads).expect("tracked"))),
        ("opacities", host(opacities.grad(grads).expect("tracked"))),
        ("pose", host(leaves.camera.cam_from_world.grad(grads).expect("tracked"))),
    ]
}

fn assert_same_gradients(what: &str, [ours, theirs]: [(&SceneTensors, &Gradients); 2]) {
    for ((name, found), (_, expected)) in gradients(ours.0, ours.1).iter().zip(gradients(theirs.0, theirs.1)) {
        assert_same(&format!("{what}: gradient of {name}"), found, &expected);
    }
}

fn assert_same_pictures(what: &str, found: &Pictures, expected: &Pictures) {
    assert_same(&format!("{what}: colour"), &found.colour, &expected.colour);
    assert_same(&format!("{what}: alpha"), &found.alpha, &expected.alpha);
    assert_same(&format!("{what}: depth"), &found.depth, &expected.depth);
}

fn dense_ellipses(leaves: &SceneTensors, options: &RenderOptions) -> DenseEllipses {
    let s = &leaves.splats;
    let geometry = [&s.means, &s.rotations, &s.scales];
    dense::project(geometry, &s.opacities, &leaves.camera.cam_from_world, &leaves.camera.intrinsics, options)
}

fn flat(t: Tensor<3>) -> Tensor<2> {
    let channels = t.dims()[2];
    t.reshape([CAMERA.width * CAMERA.height, channels])
}

#[test]
fn render_agrees_with_autodiff_of_the_dense_formulation() {
    let device = Device::flex().autodiff();
    let cameras = [CAMERA, CAMERA, FISHEYE, FISHEYE, CAMERA, CAMERA];
    for (camera, (seed, antialias)) in cameras.into_iter().zip((1..).zip([false, true].into_iter().cycle())) {
        let (what, scene, options) = (format!("seed {seed}"), scene(seed, camera), options(antialias));

        let ours = scene.tensors(&device, DType::F64);
        let extras = Extras::default().with_background(ours.background.clone());
        let out = render(&ours.splats, std::slice::from_ref(&ours.camera), &extras, &options).expect("a valid scene");
        let only = |t: Tensor<4>| flat(t.squeeze_dim(0));
        let (sum, found) = loss(only(out.colour), only(out.alpha), only(out.depth.expect("asked for")));
        let our_grads = sum.backward();

        let theirs = scene.tensors(&device, DType::F64);
        let colours = dense::evaluate_sh(&theirs.sh, &theirs.splats.means, &theirs.camera.cam_from_world);
        let ellipses = dense_ellipses(&theirs, &options);
        let out = dense::rasterize(&ellipses, &colours, &theirs.background, &CAMERA, options.alpha_max);
        let (sum, expected) = loss(out.colour, out.alpha.unsqueeze_dim(1), out.depth.unsqueeze_dim(1));
        let their_grads = sum.backward();

        assert_same_pictures(&what, &found, &expected);
        assert_same_gradients(&what, [(&ours, &our_grads), (&theirs, &their_grads)]);
        let of = |leaves: &SceneTensors, grads| host(leaves.sh.grad(grads).expect("tracked"));
        assert_same(&format!("{what}: gradient of sh"), &of(&ours, &our_grads), &of(&theirs, &their_grads));
        let of = |leaves: &SceneTensors, grads| host(leaves.background.grad(grads).expect("tracked"));
        assert_same(&format!("{what}: gradient of background"), &of(&ours, &our_grads), &of(&theirs, &their_grads));
    }
}

/// Tensor code between the stages, for both sides: every column depends on itself, on another column, and on a
/// leaf `gain` of the user.
fn edit(
    sigma_u: Tensor<1>,
    shear: Tensor<1>,
    sigma_v: Tensor<1>,
    depth: &Tensor<1>,
    gain: &Tensor<1>,
) -> [Tensor<1>; 3] {
    let widening = (depth.clone() - 3.0).square() * gain.clone();
    let wide_u = (sigma_u.square() + widening.clone()).sqrt();
    [wide_u.clone(), shear * 0.7 + (wide_u * 0.3).sin() * 0.2, (sigma_v.square() + widening).sqrt() * 1.1]
}

#[test]
fn tensor_code_between_stages_and_any_features_agree_with_the_dense_formulation() {
    let device = Device::flex().autodiff();
    let options = options(false);
    for channels in [1, 3, 5, 64] {
        let (what, scene) = (format!("{channels} channels"), scene(10 + channels as u64, CAMERA));
        let mut random = Random::new(channels as u64);
        let (features, background) = (random.fill(12 * channels, -1.0, 1.0), random.fill(channels, -1.0, 1.0));
        let gain = random.fill(12, 0.1, 0.6);
        let own_leaves = || {
            let features: Tensor<2> = tensor(&features, [12, channels], &device, DType::F64);
            let background: Tensor<1> = tensor(&background, [channels], &device, DType::F64);
            let gain: Tensor<1> = tensor(&gain, [12], &device, DType::F64);
            (features.require_grad(), background.require_grad(), gain.require_grad())
        };

        let (ours, our_own) = (scene.tensors(&device, DType::F64), own_leaves());
        let mut ellipses =
            project(&ours.splats, &ours.camera, &Extras::default(), &options).expect("a valid scene").ellipses();
        let Ellipses { sigma_u, shear, sigma_v, depth, .. } = ellipses.clone();
        [ellipses.sigma_u, ellipses.shear, ellipses.sigma_v] = edit(sigma_u, shear, sigma_v, &depth, &our_own.2);
        let projected = ellipses.pack(&CAMERA).expect("columns of one length");
        let intersections = intersect(&projected, &options).expect("valid options");
        let extras = Extras::default().with_background(our_own.1.clone());
        let out = rasterize(&projected, &our_own.0, &intersections, &extras, &options).expect("valid features");
        let (sum, found) = loss(flat(out.colour), flat(out.alpha), flat(out.depth.expect("asked for")));
        let our_grads = sum.backward();

        let (theirs, their_own) = (scene.tensors(&device, DType::F64), own_leaves());
        let mut ellipses = dense_ellipses(&theirs, &options);
        let DenseEllipses { sigma_u, shear, sigma_v, depth, .. } = ellipses.clone();
        [ellipses.sigma_u, ellipses.shear, ellipses.sigma_v] = edit(sigma_u, shear, sigma_v, &depth, &their_own.2);
        let out = dense::rasterize(&ellipses, &their_own.0, &their_own.1, &CAMERA, options.alpha_max);
        let (sum, expected) = loss(out.colour, out.alpha.unsqueeze_dim(1), out.depth.unsqueeze_dim(1));
        let their_grads = sum.backward();

        assert_same_pictures(&what, &found, &expected);
        assert_same_gradients(&what, [(&ours, &our_grads), (&theirs, &their_grads)]);
        let of = |own: &(Tensor<2>, Tensor<1>, Tensor<1>), grads| {
            let features = host(own.0.grad(grads).expect("tracked"));
            let (background, gain) = (own.1.grad(grads).expect("tracked"), own.2.grad(grads).expect("tracked"));
            [("features", features), ("background", host(background)), ("gain", host(gain))]
        };
        for ((name, found), (_, expected)) in of(&our_own, &our_grads).iter().zip(of(&their_own, &their_grads)) {
            assert_same(&format!("{what}: gradient of {name}"), found, &expected);
        }
    }
}
