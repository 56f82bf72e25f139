//! Compares the kernels of `ray_space` with the CPU twin in f64.

use super::cpu::{ray_space_backward_cpu, ray_space_cpu};
use super::launch::{launch_bounds, launch_ray_space, launch_ray_space_backward};
use super::{RAY_SPACE, bounds_cpu};
use crate::camera::Intrinsics;
use crate::gpu::{Buffer, Gpu};
use crate::options::{Projection, RenderOptions};
use crate::project::cpu::project_cpu;
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::rasterize::RasterizeSpec;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

const ALL: Geometry<bool> =
    Geometry { means: true, rotations: true, scales: true, opacities: false, cam_from_world: true, mean2d: true };

const CAMERA: Intrinsics = Intrinsics { fx: 61.0, fy: 43.0, cx: 41.5, cy: 13.25, ..Intrinsics::centred(64, 48, 61.0) };

// Classes of Gaussians. The first two are well conditioned.
const CULLED: u8 = 0;
const ORDINARY: u8 = 1;
const NEEDLE: u8 = 2;
const INSIDE: u8 = 3;
const HUGE: u8 = 4;
const TINY: u8 = 5;

const GRAD: usize = 5;

/// Returns means, rotations, scales, opacities, pose and gradient in f32 precision, and the class of each Gaussian.
fn scene(seed: u64, count: usize) -> (Vec<Vec<f64>>, Vec<Option<u8>>) {
    let mut random = Random::new(seed);
    let mut tensors = vec![Vec::new(); 4];
    let mut classes = Vec::new();
    for i in 0..count {
        let mut z = random.between(0.6, 9.0);
        let mut scale = [(); 3].map(|()| random.between(-4.0, -0.5).exp());
        let mut kind = ORDINARY;
        match i % 16 {
            1 => (kind, z) = (CULLED, -z),
            3 => (kind, scale) = (NEEDLE, [1.0, 1e-3, 1e-3]),
            5 => (kind, scale) = (INSIDE, scale.map(|s| 20.0 * s)),
            7 => (kind, scale) = (HUGE, [30.0, 29.0, 28.0].map(f64::exp)),
            9 => (kind, scale) = (TINY, [-30.0, -29.0, -28.0].map(f64::exp)),
            _ => {}
        }
        let slopes = [random.between(-2.0, 2.0), random.between(-2.0, 2.0)];
        // The pose moves points little, and does not rotate points on the camera's axis.
        tensors[0].extend([slopes[0] * z, slopes[1] * z, z]);
        tensors[1].extend((0..4).map(|_| random.between(-1.5, 1.5)));
        tensors[2].extend(scale);
        tensors[3].push(random.between(0.1, 1.0));
        classes.push(Some(kind));
    }
    let pose = vec![1.0, 0.02, -0.05, 0.1, -0.03, 0.98, 0.04, -0.2, 0.006, -0.002, 1.03, 0.1];
    let grad = random.fill(count * RAY_SPACE, -1.0, 1.0);
    tensors.extend([pose, grad]);
    (tensors.iter().map(|tensor| rounded(tensor)).collect(), classes)
}

fn inputs<F>(tensors: &[Vec<F>]) -> Geometry<&'_ [F]> {
    let [means, rotations, scales, opacities, cam_from_world, ..] = tensors else { unreachable!("five tensors") };
    Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
}

fn specs() -> [ProjectSpec; 2] {
    [0.3, 0.0].map(|blur| {
        let options = RenderOptions { blur: f64::from(blur as f32), near: 0.0, ..RenderOptions::standard() };
        ProjectSpec {
            intrinsics: CAMERA,
            options: options.with_projection(Projection::RayMax).of_project(&CAMERA),
            factors: false,
        }
    })
}

fn upload(gpu: &Gpu, tensors: &[Vec<f64>]) -> (Geometry<Buffer<f32>>, Buffer<f32>) {
    let buffer = |i: usize| Buffer::from_slice(gpu, &to_f32(&tensors[i]));
    let inputs = Geometry {
        means: buffer(0),
        rotations: buffer(1),
        scales: buffer(2),
        opacities: buffer(3),
        cam_from_world: buffer(4),
        mean2d: Buffer::new(gpu, 0),
    };
    (inputs, buffer(GRAD))
}

fn list(g: Geometry<Vec<f64>>) -> Vec<Vec<f64>> {
    vec![g.means, g.rotations, g.scales, g.cam_from_world, g.mean2d]
}

#[test]
fn kernels_agree_with_the_twin() {
    for (seed, spec) in specs().into_iter().enumerate() {
        let (tensors, classes) = scene(seed as u64, 1_200);
        let forward = PerturbedReference::new(&tensors, |tensors| vec![ray_space_cpu(inputs(tensors), &spec)]);
        let backward = PerturbedReference::new(&tensors, |tensors| {
            list(ray_space_backward_cpu(inputs(tensors), &tensors[GRAD], &spec, ALL))
        });
        for (form, gpu) in gpus() {
            let what = |what: &str| format!("{what}, {form}, spec {seed}");
            let (device, grad) = upload(&gpu, &tensors);
            let found = launch_ray_space(&gpu, &device, &spec).read(&gpu);
            forward.check(&what("rows"), 0, &found, &classes);
            let g = launch_ray_space_backward(&gpu, &device, &grad, &spec, ALL);
            for (i, found) in [g.means, g.rotations, g.scales].into_iter().enumerate() {
                let (name, found) = (what(["means", "rotations", "scales"][i]), found.expect("asked for").read(&gpu));
                backward.check_gradient(&name, i, &found, &classes, &[CULLED, ORDINARY]);
            }
            let pose = g.cam_from_world.expect("asked for").read(&gpu);
            backward.check(&what("pose"), 3, &pose, &[Some(ORDINARY); 12]);
            backward.check(&what("mean2d"), 4, &g.mean2d.expect("asked for").read(&gpu), &classes);
        }
    }
}

#[test]
fn only_what_is_needed() {
    let (tensors, _) = scene(7, 200);
    let spec = specs()[0];
    for (form, gpu) in gpus() {
        let (device, grad) = upload(&gpu, &tensors);
        let read = |needs: Geometry<bool>| {
            let g = launch_ray_space_backward(&gpu, &device, &grad, &spec, needs);
            let all = [g.means, g.rotations, g.scales, g.cam_from_world, g.mean2d];
            all.map(|buffer| buffer.map(|buffer| buffer.read(&gpu)))
        };
        let all = read(ALL);
        for alone in 0..5 {
            let [means, rotations, scales, cam_from_world, mean2d] = std::array::from_fn(|i| i == alone);
            let found = read(Geometry { means, rotations, scales, cam_from_world, mean2d, ..ALL });
            for (i, found) in found.iter().enumerate() {
                let expected = all[i].as_ref().filter(|_| i == alone);
                assert_eq!(found.as_ref(), expected, "gradient {i} of {alone} alone, {form}");
            }
        }
    }
}

#[test]
fn bounds_agree_with_the_twin() {
    let (tensors, classes) = scene(11, 1_200);
    for alpha_min in [1.0 / 255.0, 1e-6, 0.0] {
        let mut spec = specs()[0];
        spec.options.alpha_min = f64::from(alpha_min as f32);
        let rasterize = RasterizeSpec { intrinsics: CAMERA, options: spec.options };
        let rows = [project_cpu(inputs(&tensors), &spec), ray_space_cpu(inputs(&tensors), &spec)].map(|t| rounded(&t));
        let reference = PerturbedReference::new(&rows, |rows| vec![bounds_cpu(&rows[0], &rows[1], &rasterize)]);
        // Where a region is hardly bounded, or two bounds are equally large, a row may fall on either side.
        let near = [1.0 - 1e-4, 1.0 + 1e-4].map(|share| {
            let moved: Vec<f64> = rows[1].iter().map(|slope| slope * share).collect();
            bounds_cpu(&rows[0], &moved, &rasterize)
        });
        let jumps = |i: usize| {
            let row = |values: &[f64]| values[COLUMNS * i..COLUMNS * (i + 1)].to_vec();
            let expected = row(&reference.expected[0]);
            let differs = |(near, value): (f64, &f64)| !((near - value).abs() <= 1e-2 * (1.0 + value.abs()));
            let apart = |near: &Vec<f64>| row(near).into_iter().zip(&expected).any(differs);
            row(&reference.spread[0]).iter().any(|spread| *spread > 1.0) || near.iter().any(apart)
        };
        let classes: Vec<_> = classes.iter().enumerate().map(|(i, class)| class.filter(|_| !jumps(i))).collect();
        assert!(classes.iter().flatten().count() > 1_000, "too many jump");
        for (form, gpu) in gpus() {
            let [projected, ray_rows] = rows.each_ref().map(|values| Buffer::from_slice(&gpu, &to_f32(values)));
            let found = launch_bounds(&gpu, &projected, &ray_rows, &rasterize).read(&gpu);
            reference.check(&format!("bounds, {form}, alpha_min {alpha_min}"), 0, &found, &classes);
        }
    }
}

/// `intersect` leaves out a row that is not finite; a bound would hide that.
#[test]
fn an_opacity_that_is_not_finite_gets_no_bound() {
    let spec = RasterizeSpec { intrinsics: CAMERA, options: specs()[0].options };
    let row = |opacity: f32| [30.0, 20.0, 3.0, 0.1, 2.0, 4.0, opacity];
    let rows = [row(f32::NAN), row(f32::INFINITY), row(0.5)].concat();
    for (form, gpu) in gpus() {
        let projected = Buffer::from_slice(&gpu, &rows);
        let ray_rows = Buffer::from_slice(&gpu, &[0.1_f32, -0.1, 0.05, 1.0, 0.0, 0.0, 3.0, 0.1, 2.0].repeat(3));
        let found = launch_bounds(&gpu, &projected, &ray_rows, &spec).read(&gpu);
        assert!(found[6].is_nan() && found[13] == f32::INFINITY, "{form}: {found:?}");
        assert!(
            found[..6] == rows[..6] && found[7..13] == rows[7..13] && found[14..] != rows[14..],
            "{form}: {found:?}"
        );
    }
}
