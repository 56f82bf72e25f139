//! Tests that the operation rejects invalid arguments with a message that names the argument.

use burn::tensor::{DType, Device, Tensor};
use splat_op::{
    Camera, Colour, Extras, Intrinsics, Projected, RenderOptions, SplatError, contributors, evaluate_sh, intersect,
    project, rasterize, render, visible_colours,
};
use splat_tests::ndarray;
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors};

const CAMERA: Intrinsics = Intrinsics::pinhole(8, 6, [7.0, 7.0], [4.0, 3.0]);

const COUNT: usize = 5;

/// Arguments of a valid call of `render`, which a test makes invalid.
struct Call {
    tensors: SceneTensors,
    extras: Extras,
    options: RenderOptions,
}

fn call() -> Call {
    let scene = Scene::random(&mut Random::new(1), COUNT, 1, CAMERA);
    Call {
        tensors: scene.tensors(&Device::flex(), DType::F32),
        extras: Extras::default(),
        options: RenderOptions::standard(),
    }
}

fn zeros<const D: usize>(shape: [usize; D]) -> Tensor<D> {
    Tensor::zeros(shape, (&Device::flex(), DType::F32))
}

fn double<const D: usize>(t: &Tensor<D>) -> Tensor<D> {
    t.clone().cast(DType::F64)
}

/// Makes a valid call invalid and returns the error message.
fn refusal(spoil: impl FnOnce(&mut Call)) -> String {
    let mut call = call();
    spoil(&mut call);
    let Call { tensors: SceneTensors { splats, camera, .. }, extras, options } = call;
    render(&splats, &[camera], &extras, &options).expect_err("refused").to_string()
}

#[track_caller]
fn assert_names(message: &str, argument: &str, hint: &str) {
    assert!(message.contains(&format!("`{argument}`")), "`{argument}` is not named: {message}");
    assert!(message.contains(hint), "`{hint}` is missing: {message}");
}

#[test]
fn a_good_call_is_accepted() {
    let Call { tensors: SceneTensors { splats, camera, .. }, extras, options } = call();
    let out = render(&splats, &[camera], &extras, &options).expect("nothing is wrong with it");
    assert_eq!(out.colour.dims(), [1, CAMERA.height, CAMERA.width, 3]);
    assert!(out.depth.is_none(), "depth without a request for it");
}

#[test]
fn wrong_shapes_name_the_argument_and_what_to_change() {
    let must = |axis: usize, size: usize| format!("dimension {axis} must be {size}");
    assert_names(&refusal(|c| c.tensors.splats.means = zeros([COUNT, 2])), "means", &must(1, 3));
    assert_names(&refusal(|c| c.tensors.splats.rotations = zeros([COUNT, 3])), "rotations", &must(1, 4));
    assert_names(&refusal(|c| c.tensors.splats.rotations = zeros([COUNT + 1, 4])), "rotations", &must(0, COUNT));
    assert_names(&refusal(|c| c.tensors.splats.scales = zeros([COUNT, 1])), "scales", &must(1, 3));
    assert_names(&refusal(|c| c.tensors.splats.opacities = zeros([COUNT - 1])), "opacities", &must(0, COUNT));
    assert_names(&refusal(|c| c.tensors.camera.cam_from_world = zeros([4, 4])), "cam_from_world", &must(0, 3));
    let sh = |shape| Colour::SphericalHarmonics(zeros(shape));
    assert_names(&refusal(|c| c.tensors.splats.colour = sh([COUNT, 5, 3])), "sh", "[5, 5, 3]");
    assert_names(&refusal(|c| c.tensors.splats.colour = sh([COUNT, 4, 4])), "sh", &must(2, 3));
    assert_names(&refusal(|c| c.tensors.splats.colour = sh([COUNT + 2, 4, 3])), "sh", &must(0, COUNT));
    let features = |shape| Colour::Features(zeros(shape));
    assert_names(&refusal(|c| c.tensors.splats.colour = features([COUNT + 2, 3])), "features", &must(0, COUNT));
    assert_names(&refusal(|c| c.tensors.splats.colour = features([COUNT, 0])), "features", "at least one channel");
    assert_names(&refusal(|c| c.extras.background = Some(zeros([4]))), "background", &must(0, 3));
    assert_names(&refusal(|c| c.extras.mean2d_probe = Some(zeros([COUNT, 3]))), "mean2d_probe", &must(1, 2));
    let message = refusal(|c| c.extras.mean2d_abs_probe = Some(zeros([COUNT + 1, 2])));
    assert_names(&message, "mean2d_abs_probe", &must(0, COUNT));
}

#[test]
fn mixed_float_types_name_the_argument_and_the_cast() {
    let cast = "Tensor::cast";
    let spoilt = |spoil: fn(&mut Call)| refusal(spoil);
    assert_names(&spoilt(|c| c.tensors.splats.rotations = double(&c.tensors.splats.rotations)), "rotations", cast);
    assert_names(&spoilt(|c| c.tensors.splats.scales = double(&c.tensors.splats.scales)), "scales", cast);
    assert_names(&spoilt(|c| c.tensors.splats.opacities = double(&c.tensors.splats.opacities)), "opacities", cast);
    let pose = spoilt(|c| c.tensors.camera.cam_from_world = double(&c.tensors.camera.cam_from_world));
    assert_names(&pose, "cam_from_world", cast);
    assert_names(&spoilt(|c| c.extras.background = Some(double(&zeros([3])))), "background", cast);
    assert_names(&spoilt(|c| c.extras.mean2d_probe = Some(double(&zeros([COUNT, 2])))), "mean2d_probe", cast);
    let sh = spoilt(|c| c.tensors.splats.colour = Colour::SphericalHarmonics(double(&c.tensors.sh)));
    assert_names(&sh, "sh", cast);
    let half = spoilt(|c| c.tensors.splats.means = c.tensors.splats.means.clone().cast(DType::F16));
    assert_names(&half, "means", "F32 or F64");
}

#[test]
fn another_device_names_the_argument_and_the_move() {
    let message = refusal(|c| {
        let scales = Tensor::zeros([COUNT, 3], (&ndarray(), DType::F32));
        c.tensors.splats.scales = scales;
    });
    assert_names(&message, "scales", "Tensor::to_device");
}

#[test]
fn cameras_and_options_out_of_range_are_named() {
    let spoilt = |spoil: fn(&mut Call)| refusal(spoil);
    assert_names(&spoilt(|c| c.options.alpha_min = -0.1), "alpha_min", "-0.1");
    assert_names(&spoilt(|c| c.options.alpha_max = 1.5), "alpha_max", "1.5");
    assert_names(&spoilt(|c| c.options.transmittance_min = f64::NAN), "transmittance_min", "NaN");
    assert_names(&spoilt(|c| c.options.blur = f64::INFINITY), "blur", "inf");
    assert_names(&spoilt(|c| c.options.near = -1.0), "near", "-1");
    assert_names(&spoilt(|c| c.options.jacobian_margin = -1.0), "jacobian_margin", "-1");
    assert_names(&spoilt(|c| c.tensors.camera.intrinsics.width = 0), "width", "1 to 32768");
    assert_names(&spoilt(|c| c.tensors.camera.intrinsics.height = 40_000), "height", "40000");
    assert_names(&spoilt(|c| c.tensors.camera.intrinsics.fx = 0.0), "fx", "positive");
    assert_names(&spoilt(|c| c.tensors.camera.intrinsics.fy = f64::NAN), "fy", "NaN");
    assert_names(&spoilt(|c| c.tensors.camera.intrinsics.cx = f64::INFINITY), "cx", "finite");
    let Call { tensors: SceneTensors { splats, camera, .. }, extras, options } = call();
    let none = render(&splats, &[], &extras, &options).expect_err("refused");
    assert_names(&none.to_string(), "cameras", "at least one");
    let wide = Camera { intrinsics: Intrinsics::pinhole(9, 6, [7.0, 7.0], [4.0, 3.0]), ..camera.clone() };
    let sizes = render(&splats, &[camera, wide], &extras, &options).expect_err("refused");
    assert_names(&sizes.to_string(), "cameras", "(9, 6)");
}

#[test]
fn single_stages_check_their_own_arguments() {
    let Call { tensors: SceneTensors { splats, sh, camera, .. }, extras, options } = call();
    let message = evaluate_sh(&sh, &zeros([COUNT + 1, 3]), &camera).expect_err("refused").to_string();
    assert_names(&message, "sh", "dimension 0 must be 6");
    let projected = project(&splats, &camera, &Extras::default(), &options).expect("a valid scene");
    let intersections = intersect(&projected, &options).expect("valid options");
    let message =
        rasterize(&projected, &zeros([COUNT + 1, 3]), &intersections, &extras, &options).expect_err("refused");
    assert_names(&message.to_string(), "features", "dimension 0 must be 5");
    let mut ellipses = projected.ellipses();
    ellipses.shear = zeros([COUNT + 1]);
    let error = ellipses.pack(&CAMERA).expect_err("refused");
    assert!(matches!(error, SplatError::Shape { name: "shear", .. }), "{error}");
}

/// A stage that is called alone checks what it reads, and nothing else, with the messages of a render.
#[test]
fn a_stage_alone_refuses_what_a_render_refuses() {
    let Call { tensors: SceneTensors { splats, camera, .. }, extras, options } = call();
    let projected = project(&splats, &camera, &extras, &options).expect("nothing is wrong with it");
    let lists = intersect(&projected, &options).expect("nothing is wrong with it");
    let refused_by = |spoil: fn(&mut Call), stages: &[&str]| {
        let expected = refusal(spoil);
        let mut bad = call();
        spoil(&mut bad);
        let Call { tensors: SceneTensors { splats, camera, .. }, extras, options } = &bad;
        let found = [
            ("project", project(splats, camera, extras, options).err()),
            ("visible_colours", visible_colours(splats, camera, &projected, options).err()),
            ("intersect", intersect(&projected, options).err()),
            ("rasterize", rasterize(&projected, &zeros([COUNT, 3]), &lists, extras, options).err()),
        ];
        for (stage, error) in found {
            let expected = stages.contains(&stage).then(|| expected.clone());
            assert_eq!(error.map(|error| error.to_string()), expected, "{stage}");
        }
    };
    let all = ["project", "visible_colours", "intersect", "rasterize"];
    refused_by(|c| c.options.alpha_min = -0.1, &all);
    refused_by(|c| c.tensors.splats.means = double(&c.tensors.splats.means).cast(DType::F16), &all[..2]);
    refused_by(|c| c.tensors.splats.means = zeros([COUNT, 2]), &all[..2]);
    refused_by(|c| c.tensors.camera.cam_from_world = zeros([4, 4]), &all[..2]);
    refused_by(|c| c.tensors.splats.scales = zeros([COUNT, 1]), &["project"]);
    refused_by(|c| c.tensors.camera.intrinsics.fx = 0.0, &["project"]);
    refused_by(|c| c.extras.mean2d_probe = Some(zeros([COUNT, 3])), &["project"]);
    refused_by(|c| c.tensors.splats.colour = Colour::SphericalHarmonics(zeros([COUNT, 5, 3])), &["visible_colours"]);
    refused_by(|c| c.extras.background = Some(zeros([4])), &["rasterize"]);
    refused_by(|c| c.extras.mean2d_abs_probe = Some(zeros([COUNT + 1, 2])), &["rasterize"]);
}

#[test]
fn lists_of_another_view_are_refused() {
    let options = RenderOptions::standard();
    let scene = |count, intrinsics| {
        let scene = Scene::random(&mut Random::new(1), count, 1, intrinsics);
        scene.tensors(&Device::flex(), DType::F32)
    };
    let view = |count, intrinsics| {
        let SceneTensors { splats, camera, .. } = scene(count, intrinsics);
        project(&splats, &camera, &Extras::default(), &options).expect("nothing is wrong with it")
    };
    let projected = view(COUNT, CAMERA);
    let with = |lists: &Projected, list_options: &RenderOptions| {
        let lists = intersect(lists, list_options).expect("nothing is wrong with it");
        let picture = rasterize(&projected, &zeros([COUNT, 3]), &lists, &Extras::default(), &options).map(drop);
        let said = |result: &Result<(), SplatError>| result.as_ref().err().map(ToString::to_string);
        let found = contributors(&projected, &lists, 1, &options).map(drop);
        assert_eq!(said(&found), said(&picture), "both take the lists, or refuse them alike");
        picture
    };
    with(&projected, &options).expect("its own lists");
    let refusal = |lists: &Projected, options: &RenderOptions| with(lists, options).expect_err("refused").to_string();
    assert_names(&refusal(&view(COUNT + 3, CAMERA), &options), "intersections", "8 Gaussians, for 5");
    let larger = Intrinsics::pinhole(40, 30, [7.0, 7.0], [4.0, 3.0]);
    assert_names(&refusal(&view(COUNT, larger), &options), "intersections", "40 × 30 px, for 8 × 6 px");
    let other = CAMERA.with_focal(9.0, CAMERA.fy);
    assert_names(&refusal(&view(COUNT, other), &options), "intersections", "another camera");
    let [fewer, more] = [0.1, 0.0].map(|alpha_min| options.with_alpha_min(alpha_min));
    assert_names(&refusal(&projected, &fewer), "intersections", "a smaller `alpha_min`");
    with(&projected, &more).expect("lists of all pairs serve any threshold");
    let deep = options.with_depth(true);
    assert_names(&refusal(&projected, &deep), "intersections", "depth: true");
    let SceneTensors { splats, camera, .. } = scene(COUNT, CAMERA);
    let of_others = visible_colours(&splats, &camera, &view(COUNT + 3, CAMERA), &options).expect_err("refused");
    assert_names(&of_others.to_string(), "projected", "[8, 7]");
}
