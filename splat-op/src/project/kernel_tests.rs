//! The kernels of `project` against the twin in f64.

use cubecl::prelude::{ComptimeOptionArgs, CubeCount, CubeDim};
use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::backward::project_backward_kernel;
use super::cpu::{project_backward_cpu, project_cpu};
use super::launch::{launch_project, launch_project_backward, lens};
use super::{COLUMNS, COMPENSATION_MIN, Geometry, ProjectSpec};
use crate::camera::{CameraModel, Intrinsics};
use crate::gpu::{Buffer, Gpu, UNITS};
use crate::options::RenderOptions;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::lenses::lenses;
use crate::testing::random::Random;

const ALL: Geometry<bool> =
    Geometry { means: true, rotations: true, scales: true, opacities: true, cam_from_world: true, mean2d: true };
const NAMES: [&str; 6] = ["means", "rotations", "scales", "opacities", "pose", "mean2d"];

// Classes of Gaussians. The Gaussians of the first two classes are well-conditioned.
const CULLED: u8 = 0;
const ORDINARY: u8 = 1;
const NEEDLE: u8 = 2;
const NEAR: u8 = 3;
const HUGE: u8 = 4;
const TINY: u8 = 5;
const SHORT_QUATERNION: u8 = 6;
const LONG_QUATERNION: u8 = 7;

/// Camera, pose and options.
struct TestCamera {
    pose: Vec<f64>,
    /// Width and height, px.
    size: [usize; 2],
    model: CameraModel,
    /// fx, fy, cx and cy, px, and the eight coefficients of the model.
    lens: Vec<f64>,
    options: RenderOptions,
}

impl TestCamera {
    /// Camera 0 is at the origin, with its principal point at the centre of the picture. Camera 1 is rotated and moved, and its
    /// principal point is off centre. The matrix of camera 2 is not a rotation, and its principal point lies outside the picture.
    fn new(which: usize, blur: f64, antialias: bool) -> Self {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.4, -0.3, 0.2, 0.8).normalize());
        let (matrix, translation, lens, near) = match which {
            0 => (DMat3::IDENTITY, DVec3::ZERO, [50.0, 50.0, 32.0, 24.0], 0.01),
            1 => (turn, DVec3::new(3.0, -2.0, 5.0), [61.0, 43.0, 41.5, 13.25], 0.5),
            _ => {
                let bend = DMat3::from_cols_array(&[1.1, 0.05, -0.04, 0.02, 0.9, 0.06, -0.03, 0.07, 1.05]);
                (bend * turn, DVec3::new(-40.0, 10.0, 2.0), [47.0, 55.0, -9.5, 60.0], 0.2)
            }
        };
        let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis, translation];
        let pose: Vec<f64> = (0..3).flat_map(|row| columns.map(|column| column[row])).collect();
        let options = RenderOptions { blur: f64::from(blur as f32), antialias, ..RenderOptions::standard() };
        let options = RenderOptions { near: f64::from(near as f32), ..options };
        let lens = rounded(&[&lens[..], &[0.0; 8]].concat());
        Self { pose: rounded(&pose), size: [64, 48], model: CameraModel::Pinhole, lens, options }
    }

    fn with_lens(mut self, (model, distortion): (CameraModel, [f64; 8])) -> Self {
        self.model = model;
        self.lens[4..].copy_from_slice(&rounded(&distortion));
        self
    }

    fn spec(&self, lens: &[f64]) -> ProjectSpec {
        let ([width, height], [fx, fy, cx, cy]) = (self.size, [lens[0], lens[1], lens[2], lens[3]]);
        let distortion = std::array::from_fn(|i| lens[4 + i]);
        let intrinsics = Intrinsics { model: self.model, distortion, width, height, fx, fy, cx, cy };
        ProjectSpec { intrinsics, options: self.options }
    }

    /// Limits to which the Jacobian's slopes are clamped: low and high along x, then along y.
    fn limits(&self, lens: &[f64]) -> [f64; 4] {
        let [[low_x, high_x], [low_y, high_y]] = self.spec(lens).intrinsics.slope_limits(self.options.jacobian_margin);
        [low_x, high_x, low_y, high_y]
    }
}

/// Means, rotations, scales, opacities, pose, lens and gradient, all in f32 precision, and the kind of each Gaussian.
struct StageInputs {
    tensors: Vec<Vec<f64>>,
    kinds: Vec<u8>,
}

const POSE: usize = 4;
const LENS: usize = 5;
const GRAD: usize = 6;

fn inputs<F>(tensors: &[Vec<F>]) -> Geometry<&'_ [F]> {
    let [means, rotations, scales, opacities, cam_from_world, ..] = tensors else { unreachable!("five tensors") };
    Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
}

impl StageInputs {
    /// Gaussians in view, outside it and behind the camera, with invalid values, and without a gradient; extreme ones too if `wild`.
    fn random(seed: u64, count: usize, view: &TestCamera, wild: bool) -> Self {
        let mut random = Random::new(seed);
        let p = &view.pose;
        let column = |c: usize| DVec3::new(p[c], p[4 + c], p[8 + c]);
        let pose = DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) };
        let [low_x, high_x, low_y, high_y] = view.limits(&view.lens);
        let mut tensors = vec![Vec::new(); 4];
        let mut grad = random.fill(count * COLUMNS, -1.0, 1.0);
        let mut kinds = Vec::new();
        for i in 0..count {
            let mut kind = ORDINARY;
            let mut z = random.between(0.6, 9.0);
            let mut slopes = [random.between(low_x, high_x), random.between(low_y, high_y)];
            let mut scale = [(); 3].map(|()| random.between(-4.0, -0.5).exp());
            let mut rotation = [(); 4].map(|()| random.between(-1.5, 1.5));
            let mut bad = f64::NAN;
            match (i % 16, wild) {
                (1, _) => slopes[i / 16 % 2] += [3.0, -3.0][i / 32 % 2],
                (3, _) => z = -z,
                (5, _) => scale = [(); 3].map(|()| random.between(1e-4, 4e-4)),
                (7, _) => {
                    // Keeps at most one element of the gradient.
                    let row = grad[COLUMNS * i..COLUMNS * (i + 1)].iter_mut().enumerate();
                    row.filter(|(column, _)| *column != i / 16 % 8).for_each(|(_, grad)| *grad = 0.0);
                }
                (9, _) => bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][i / 16 % 3],
                (11, _) => rotation = [0.0; 4],
                (15, _) => scale = [scale[0]; 3],
                (2, true) => (kind, scale) = (NEEDLE, [1.0, 1e-3, 1e-3]),
                (4, true) => (kind, z) = (NEAR, view.options.near * random.between(0.5, 2.0)),
                (6, true) => (kind, scale) = (HUGE, [50.0, 49.0, 48.0].map(f64::exp)),
                (8, true) => (kind, scale) = (TINY, [-50.0, -49.0, -48.0].map(f64::exp)),
                (10, true) => (kind, scale[i / 16 % 3]) = (HUGE, 50.0_f64.exp()),
                (12, true) => (kind, scale[i / 16 % 3]) = (NEEDLE, (-50.0_f64).exp()),
                (13, true) => (kind, rotation) = (SHORT_QUATERNION, rotation.map(|q| 1e-20 * q)),
                (14, true) => (kind, rotation) = (LONG_QUATERNION, rotation.map(|q| 1e20 * q)),
                _ => {}
            }
            let mean = pose.inverse().transform_point3(DVec3::new(slopes[0] * z, slopes[1] * z, z));
            tensors[0].extend(mean.to_array());
            tensors[1].extend(rotation);
            tensors[2].extend(scale);
            tensors[3].push(random.between(0.1, 1.0));
            if i % 16 == 9 {
                let tensor = i / 16 % 4;
                let last = tensors[tensor].len() - 1 - if tensor == 3 { 0 } else { i / 64 % 3 };
                tensors[tensor][last] = bad;
            }
            kinds.push(kind);
        }
        tensors.extend([view.pose.clone(), view.lens.clone(), grad]);
        Self { tensors: tensors.iter().map(|tensor| rounded(tensor)).collect(), kinds }
    }

    fn count(&self) -> usize {
        self.kinds.len()
    }

    fn upload(&self, gpu: &Gpu) -> (Geometry<Buffer<f32>>, Buffer<f32>) {
        let buffer = |i: usize| Buffer::from_slice(gpu, &to_f32(&self.tensors[i]));
        let inputs = Geometry {
            means: buffer(0),
            rotations: buffer(1),
            scales: buffer(2),
            opacities: buffer(3),
            cam_from_world: buffer(POSE),
            mean2d: Buffer::new(gpu, 0),
        };
        (inputs, buffer(GRAD))
    }

    /// Class of each Gaussian. The band contains Gaussians that are culled or not depending on rounding and, for the backward pass,
    /// those that rounding may move across a limit of the Jacobian or the lower limit of the compensation.
    fn classes(&self, view: &TestCamera, backward: bool) -> Vec<Option<u8>> {
        let spec = view.spec(&view.lens);
        let margins = PerturbedReference::new(&self.tensors, |tensors| margins(tensors, view));
        let (cull, rest) = (margins.near_zero(0), margins.near_zero(1));
        let cull: Vec<bool> = cull.chunks_exact(2).map(|pair| pair.contains(&true)).collect();
        let seen: Vec<bool> =
            project_cpu(inputs(&self.tensors), &spec).chunks_exact(COLUMNS).map(|row| row[5] > 0.0).collect();
        let class = |i: usize| {
            let jumps = cull[i] || (backward && seen[i] && rest[5 * i..5 * (i + 1)].contains(&true));
            (!jumps).then(|| if seen[i] { self.kinds[i] } else { CULLED })
        };
        let classes: Vec<_> = (0..self.count()).map(class).collect();
        let band = classes.iter().filter(|class| class.is_none()).count();
        assert!(band <= 1 + self.count() / 100, "{band} of {} Gaussians in the band", self.count());
        classes
    }
}

/// Relative distances from the thresholds: `[N, 2]` from the near plane and the radius of the lens's domain; `[N, 5]` from the limits
/// of the Jacobian and from the lower limit of the compensation, which is the ratio of the ellipse's area without blur to that with
/// it.
fn margins(tensors: &[Vec<f64>], view: &TestCamera) -> Vec<Vec<f64>> {
    let (p, limits) = (&tensors[POSE], view.limits(&tensors[LENS]));
    let mut spec = view.spec(&tensors[LENS]);
    let area = |spec: &ProjectSpec| -> Vec<f64> {
        project_cpu(inputs(tensors), spec).chunks_exact(COLUMNS).map(|row| row[2] * row[4]).collect()
    };
    let blurred = area(&spec);
    spec.options.blur = 0.0;
    let areas = area(&spec);
    let (mut near, mut rest) = (Vec::new(), Vec::new());
    for (i, m) in tensors[0].chunks_exact(3).enumerate() {
        let along = |row: usize| (0..3).map(|k| p[4 * row + k] * m[k]).sum::<f64>() + p[4 * row + 3];
        let (x, y, z) = (along(0), along(1), along(2));
        let slope = (x / z).hypot(y / z);
        let (fisheye, max_radius) = (view.model.is_fisheye(), spec.intrinsics.max_radius());
        near.extend([z / view.options.near - 1.0, if fisheye { slope.atan() } else { slope } / max_radius - 1.0]);
        let slopes = if fisheye { [f64::NAN; 4] } else { [x / z, x / z, y / z, y / z] };
        rest.extend(slopes.iter().zip(limits).map(|(slope, limit)| (slope - limit) / (1.0 + limit.abs())));
        rest.push(if view.options.antialias { areas[i] / blurred[i] / COMPENSATION_MIN - 1.0 } else { f64::NAN });
    }
    vec![near, rest]
}

fn list(g: Geometry<Vec<f64>>) -> Vec<Vec<f64>> {
    vec![g.means, g.rotations, g.scales, g.opacities, g.cam_from_world, g.mean2d]
}

fn read(gpu: &Gpu, g: &Geometry<Option<Buffer<f32>>>) -> [Option<Vec<f32>>; 6] {
    [&g.means, &g.rotations, &g.scales, &g.opacities, &g.cam_from_world, &g.mean2d]
        .map(|buffer| buffer.as_ref().map(|buffer| buffer.read(gpu)))
}

fn check_forward(what: &str, scene: &StageInputs, view: &TestCamera) -> f64 {
    let classes = scene.classes(view, false);
    let forward = |tensors: &[Vec<f64>]| vec![project_cpu(inputs(tensors), &view.spec(&tensors[LENS]))];
    let reference = PerturbedReference::new(&scene.tensors, forward);
    let mut worst = 0.0_f64;
    for (form, gpu) in gpus() {
        let found = launch_project(&gpu, &scene.upload(&gpu).0, &view.spec(&view.lens)).read(&gpu);
        worst = worst.max(reference.check(&format!("projected, {what}, {form}"), 0, &found, &classes));
    }
    worst
}

/// A scene whose Gaussians in the band have no gradient, its classes, and the twin's results.
fn backward_reference(mut scene: StageInputs, view: &TestCamera) -> (StageInputs, Vec<Option<u8>>, PerturbedReference) {
    let classes = scene.classes(view, true);
    for (i, _) in classes.iter().enumerate().filter(|(_, class)| class.is_none()) {
        scene.tensors[GRAD][COLUMNS * i..COLUMNS * (i + 1)].fill(0.0);
    }
    let reference = PerturbedReference::new(&scene.tensors, |tensors| {
        let mut spec = view.spec(&tensors[LENS]);
        // Without blur the compensation is one and its gradient zero, which the twin computes as a difference.
        spec.options.antialias &= spec.options.blur > 0.0;
        list(project_backward_cpu(inputs(tensors), &tensors[GRAD], &spec, ALL))
    });
    (scene, classes, reference)
}

fn check_backward(what: &str, scene: StageInputs, view: &TestCamera, needs: &[Geometry<bool>]) -> f64 {
    let (scene, classes, reference) = backward_reference(scene, view);
    let mut worst = 0.0_f64;
    for (form, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        for needs in needs {
            let found = launch_project_backward(&gpu, &inputs, &grad, &view.spec(&view.lens), *needs);
            let Geometry { means, rotations, scales, opacities, cam_from_world, mean2d } = *needs;
            let needed = [means, rotations, scales, opacities, cam_from_world, mean2d];
            for (i, found) in read(&gpu, &found).into_iter().enumerate() {
                let what = format!("gradient of {}, {what}, {form}", NAMES[i]);
                assert_eq!(found.is_some(), needed[i], "{what}");
                let Some(found) = found else { continue };
                let share = match i {
                    // One class and one column: the floor is relative to the largest entry.
                    POSE => reference.check(&what, i, &found, &[Some(ORDINARY); 12]),
                    _ => reference.check_gradient(&what, i, &found, &classes, &[CULLED, ORDINARY]),
                };
                worst = worst.max(share);
            }
        }
    }
    worst
}

/// Combinations of views, blurs and anti-aliasing.
fn views() -> impl Iterator<Item = (String, TestCamera)> {
    (0..12).map(|i| {
        let (which, blur, antialias) = (i % 3, [0.3, 0.0][i / 3 % 2], i >= 6);
        (format!("view {which}, blur {blur}, antialias {antialias}"), TestCamera::new(which, blur, antialias))
    })
}

#[test]
fn forward_agrees_with_the_twin() {
    for (i, (what, view)) in views().enumerate() {
        let scene = StageInputs::random(i as u64, 1_500, &view, true);
        println!("{what}: {:.3}", check_forward(&what, &scene, &view));
    }
}

#[test]
fn backward_agrees_with_the_twin() {
    for (i, (what, view)) in views().enumerate() {
        for wild in [false, true] {
            let scene = StageInputs::random(100 + i as u64, 1_500, &view, wild);
            let what = format!("{what}, wild {wild}");
            println!("{what}: {:.3}", check_backward(&what, scene, &view, &[ALL]));
        }
    }
}

#[test]
fn every_lens_agrees_with_the_twin() {
    for (i, lens) in lenses().into_iter().enumerate() {
        let view = TestCamera::new(1, 0.3, i % 2 == 1).with_lens(lens);
        for wild in [false, true] {
            let (seed, what) = (200 + 2 * i as u64, format!("{lens:?}, wild {wild}"));
            let forward = check_forward(&what, &StageInputs::random(seed, 1_500, &view, wild), &view);
            let backward = check_backward(&what, StageInputs::random(seed + 1, 1_500, &view, wild), &view, &[ALL]);
            println!("{what}: {forward:.3}, {backward:.3}");
        }
    }
}

/// The polynomials of a fisheye differ between the float types.
#[test]
fn the_twin_in_f32_agrees_with_itself_in_f64_for_every_lens() {
    for (i, lens) in lenses().into_iter().enumerate() {
        let view = TestCamera::new(1, 0.3, i % 2 == 1).with_lens(lens);
        let scene = StageInputs::random(300 + i as u64, 1_500, &view, false);
        let classes = scene.classes(&view, false);
        let spec = |tensors: &[Vec<f64>]| view.spec(&tensors[LENS]);
        let reference =
            PerturbedReference::new(&scene.tensors, |tensors| vec![project_cpu(inputs(tensors), &spec(tensors))]);
        let in_f32 = |scene: &StageInputs| scene.tensors.iter().map(|tensor| to_f32(tensor)).collect::<Vec<_>>();
        let found = project_cpu(inputs(&in_f32(&scene)), &spec(&scene.tensors));
        let forward = reference.check(&format!("{lens:?} in f32"), 0, &found, &classes);

        let (scene, classes, reference) = backward_reference(scene, &view);
        let tensors = in_f32(&scene);
        let found = project_backward_cpu(inputs(&tensors), &tensors[GRAD], &spec(&scene.tensors), ALL);
        let what = format!("gradient of means, {lens:?} in f32");
        let backward = reference.check_gradient(&what, 0, &found.means, &classes, &[CULLED, ORDINARY]);
        println!("{lens:?}: {forward:.3}, {backward:.3}");
    }
}

#[test]
fn any_number_of_gaussians() {
    let view = TestCamera::new(1, 0.3, true);
    for count in [1, 2, 255, 256, 257, 100_000] {
        let what = format!("{count} Gaussians");
        let forward = check_forward(&what, &StageInputs::random(count as u64, count, &view, true), &view);
        let backward = check_backward(&what, StageInputs::random(count as u64, count, &view, false), &view, &[ALL]);
        println!("{what}: {forward:.3}, {backward:.3}");
    }
}

#[test]
fn no_gaussians() {
    let view = TestCamera::new(1, 0.3, true);
    let scene = StageInputs::random(0, 0, &view, false);
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let spec = view.spec(&view.lens);
        assert!(launch_project(&gpu, &inputs, &spec).read(&gpu).is_empty());
        let found = read(&gpu, &launch_project_backward(&gpu, &inputs, &grad, &spec, ALL));
        for (i, found) in found.into_iter().enumerate() {
            assert_eq!(found, Some(vec![0.0; if i == POSE { 12 } else { 0 }]));
        }
    }
}

#[test]
fn gradients_are_computed_where_asked_for() {
    let flags = |on: [bool; 6]| {
        let [means, rotations, scales, opacities, cam_from_world, mean2d] = on;
        Geometry { means, rotations, scales, opacities, cam_from_world, mean2d }
    };
    let mut needs = vec![flags([false; 6])];
    for i in 0..6 {
        needs.push(flags(std::array::from_fn(|j| i == j)));
        needs.push(flags(std::array::from_fn(|j| i != j)));
    }
    let view = TestCamera::new(1, 0.3, true);
    check_backward("part", StageInputs::random(7, 300, &view, true), &view, &needs);
}

/// A dispatch along two axes has more cubes than the Gaussians need; the surplus cubes write nothing.
#[test]
fn surplus_cubes_write_nothing() {
    let (view, count) = (TestCamera::new(1, 0.3, true), 300);
    let scene = StageInputs::random(9, count, &view, false);
    let nothing = || ComptimeOptionArgs::None;
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let rows = Buffer::<f32>::new(&gpu, 6 * 12);
        let opacities = Buffer::<f32>::new(&gpu, 6 * UNITS);
        // SAFETY: the outputs have room for every cube, and the kernel guards the inputs.
        unsafe {
            project_backward_kernel::launch_unchecked(
                &gpu.client,
                CubeCount::Static(3, 2, 1),
                CubeDim::new_1d(UNITS as u32),
                inputs.means.arg(),
                inputs.rotations.vectors(4),
                inputs.scales.arg(),
                inputs.opacities.arg(),
                inputs.cam_from_world.arg(),
                grad.arg(),
                nothing(),
                ComptimeOptionArgs::None,
                nothing(),
                ComptimeOptionArgs::Some(opacities.arg()),
                nothing(),
                ComptimeOptionArgs::Some(rows.arg()),
                lens(&view.spec(&view.lens)),
                count as u32,
            );
        }
        // In tests, slots that no kernel wrote are NaN.
        let written = |values: Vec<f32>| values.into_iter().map(|value| !value.is_nan()).collect::<Vec<_>>();
        let expected = |len: usize, first: usize| (0..len).map(|i| i < first).collect::<Vec<_>>();
        assert_eq!(written(rows.read(&gpu)), expected(6 * 12, 2 * 12));
        assert_eq!(written(opacities.read(&gpu)), expected(6 * UNITS, count));
    }
}

#[test]
fn a_second_run_gives_the_same_bits() {
    let view = TestCamera::new(2, 0.3, true);
    let scene = StageInputs::random(8, 20_000, &view, true);
    let bits = |values: Option<Vec<f32>>| values.expect("asked for").into_iter().map(f32::to_bits).collect::<Vec<_>>();
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let run = || read(&gpu, &launch_project_backward(&gpu, &inputs, &grad, &view.spec(&view.lens), ALL)).map(bits);
        assert!(run() == run());
    }
}

/// A gradient that is NaN must reach every parameter, for the guard to see.
#[test]
fn nan_passes_the_limit_of_a_quaternions_gradient() {
    let view = TestCamera::new(1, 0.3, false);
    let mut scene = StageInputs::random(5, 100, &view, false);
    let spec = view.spec(&view.lens);
    let seen = project_cpu(inputs(&scene.tensors), &spec);
    let row = seen.chunks_exact(COLUMNS).position(|row| row[5] > 0.0).expect("some are in view");
    scene.tensors[GRAD][COLUMNS * row..COLUMNS * (row + 1)].fill(f64::NAN);
    for (form, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let found = read(&gpu, &launch_project_backward(&gpu, &inputs, &grad, &spec, ALL));
        let rotations = found[1].as_ref().expect("asked for");
        assert!(rotations[4 * row..4 * (row + 1)].iter().all(|value| value.is_nan()), "{form}: {rotations:?}");
        let others = rotations[..4 * row].iter().chain(&rotations[4 * (row + 1)..]);
        assert!(others.into_iter().all(|value| value.is_finite()), "{form}");
    }
}
