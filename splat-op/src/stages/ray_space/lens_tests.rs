//! The columns of a lens, their gradients and the bounds in its picture, in the twin and in the kernels.

use super::cpu::ray_space_cpu;
use super::{LENS_COLUMNS as ROW, RAY_SPACE, bounds_cpu};
use crate::camera::{CameraModel, Intrinsics, PictureRays};
use crate::intersect::cpu::intersect_cpu;
use crate::options::{Projection, RenderOptions};
use crate::project::cpu::project_cpu;
use crate::project::{COLUMNS, Ellipse, Geometry, ProjectSpec};
use crate::rasterize::RasterizeSpec;
use crate::simd::Real;
use crate::testing::lenses::lenses;
use crate::testing::random::Random;

const POSE: [f32; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

fn spec((model, distortion): (CameraModel, [f64; 8]), focal: f64) -> ProjectSpec {
    let plain = Intrinsics { fy: 0.95 * focal, cx: 76.0, cy: 59.5, ..Intrinsics::centred(160, 112, focal) };
    let options = RenderOptions { blur: 0.3f32.into(), near: 0.0, ..RenderOptions::standard() };
    let intrinsics = Intrinsics { model, distortion, ..plain };
    ProjectSpec {
        intrinsics,
        options: options.with_projection(Projection::RayMax).of_project(&intrinsics),
        factors: false,
    }
}

/// Means, rotations, scales, opacities and pose of Gaussians up to `slope` from the axis, as slopes; a few lie behind the camera.
fn scene(seed: u64, count: usize, slope: f64) -> Vec<Vec<f64>> {
    let mut random = Random::new(seed);
    let (mut means, mut scales) = (Vec::new(), Vec::new());
    for i in 0..count {
        let z = if i % 16 == 15 { -1.0 } else { random.between(0.5, 5.0) };
        means.extend([random.between(-slope, slope) * z, random.between(-slope, slope) * z, z]);
        let size = random.between(-5.5, -1.5).exp() * z;
        scales.extend([size, size * random.between(0.05, 1.0), size * random.between(0.05, 1.0)]);
    }
    let pose = vec![1.0, 0.02, -0.05, 0.1, -0.03, 0.98, 0.04, -0.2, 0.006, -0.002, 1.03, 0.1];
    let opacities = random.fill(count, 0.05, 1.0);
    vec![means, random.fill(4 * count, -1.5, 1.5), scales, opacities, pose]
}

fn inputs<F>(tensors: &[Vec<F>]) -> Geometry<&'_ [F]> {
    let [means, rotations, scales, opacities, cam_from_world, ..] = tensors else { unreachable!("five tensors") };
    Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
}

/// Near 90° from its axis a fisheye shrinks the picture along the direction from the axis by `cos² θ`, and a hundred times less across it.
#[test]
fn the_rim_of_a_fisheye_keeps_the_digits_along_its_radius() {
    let spec = spec((CameraModel::Fisheye, [0.0; 8]), 19.0);
    let focal = [spec.intrinsics.fx, spec.intrinsics.fy];
    for (degrees, turn) in [80.0_f64, 86.0, 89.45].into_iter().flat_map(|degrees| (0..24).map(move |k| (degrees, k))) {
        let (angle, turn) = (degrees.to_radians(), f64::from(turn) / 24.0 * std::f64::consts::TAU);
        let ray = [angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos()];
        let mean = ray.map(|c| (6.9 * c) as f32);
        let scene = [mean.to_vec(), vec![1.0, 0.0, 0.0, 0.0], vec![0.2; 3], vec![0.5], POSE.to_vec()];
        let row = ray_space_cpu(inputs(&scene), &spec);
        let [x, y, z] = mean.map(f64::from);
        let across = x.hypot(y);
        let (n, cos) = ([x / across, y / across], z / across.hypot(z));
        for axis in 0..2 {
            let g = [0, 1].map(|k| f64::from(row[RAY_SPACE + 2 + 2 * axis + k]) * n[k]);
            let (found, expected) = (g[0] + g[1], focal[axis] * cos * cos * n[axis]);
            // The entries themselves are rounded.
            let tolerance = 8.0 * f64::from(f32::EPSILON) * (g[0].abs() + g[1].abs());
            assert!((found - expected).abs() <= tolerance, "{degrees}°, {turn}: {found} instead of {expected}");
        }
    }
}

/// The derivative of the projected centre by the centre's slopes, from finite differences, and the slopes.
#[test]
fn the_columns_are_slopes_and_the_jacobian_of_the_lens() {
    for lens in lenses() {
        let (spec, tensors) = (spec(lens, 130.0), scene(3, 32, 0.8));
        let rows = ray_space_cpu(inputs(&tensors), &spec);
        let p = &tensors[4];
        for (mean, row) in tensors[0].chunks_exact(3).zip(rows.chunks_exact(ROW)).filter(|(mean, _)| mean[2] > 0.0) {
            let cam: Vec<f64> =
                p.chunks_exact(4).map(|p| p[0] * mean[0] + p[1] * mean[1] + p[2] * mean[2] + p[3]).collect();
            let slopes = [cam[0] / cam[2], cam[1] / cam[2]];
            let seen = |x: f64, y: f64| spec.intrinsics.px_from_cam(glam::DVec3::new(x, y, 1.0)).expect("within");
            let h = 1e-5;
            let by_x = (seen(slopes[0] + h, slopes[1]) - seen(slopes[0] - h, slopes[1])) / (2.0 * h);
            let by_y = (seen(slopes[0], slopes[1] + h) - seen(slopes[0], slopes[1] - h)) / (2.0 * h);
            let expected = [slopes[0], slopes[1], by_x.x, by_y.x, by_x.y, by_y.y];
            for (found, expected) in row[RAY_SPACE..].iter().zip(expected) {
                assert!((found - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{lens:?}: {row:?} {expected:?}");
            }
        }
    }
}

/// Compares the tiles that bounds list with all pixels, evaluated in `F` as `rasterize_rays` does. Returns the numbers of tiles that
/// are needed, and that are listed.
fn check_tiles<F: Real>(lens: (CameraModel, [f64; 8]), focal: f64, slope: f64, alpha_min: f64) -> [usize; 2] {
    let project = spec(lens, focal);
    let tensors = scene(9, 400, slope);
    let spec =
        RasterizeSpec { intrinsics: project.intrinsics, options: RenderOptions { alpha_min, ..project.options } };
    let rays = PictureRays::of(&spec.intrinsics).expect("a lens");
    let of = |values: Vec<f64>| values.into_iter().map(F::of).collect::<Vec<F>>();
    let packed = of(project_cpu(inputs(&tensors), &project));
    let ray_rows = of(ray_space_cpu(inputs(&tensors), &project));
    let bounds = bounds_cpu(&packed, &ray_rows, &spec);
    let mut counts = [0; 2];
    for ((row, bound), t) in packed.chunks(COLUMNS).zip(bounds.chunks(COLUMNS)).zip(ray_rows.chunks(ROW)) {
        let e = Ellipse::from_row(row);
        if !(e.depth > F::ZERO) {
            continue;
        }
        let mut needed = vec![0; 70];
        for (pixel, slopes) in rays.slopes.iter().enumerate().filter(|(_, slopes)| slopes[0] < 1e29) {
            let frame = &t[RAY_SPACE..];
            let (sx, sy) = (F::of(slopes[0]) - frame[0], F::of(slopes[1]) - frame[1]);
            let (dx, dy) = (frame[2] * sx + frame[3] * sy, frame[4] * sx + frame[5] * sy);
            let (u, v) = (dx / e.sigma_u, (dy - e.shear * dx) / e.sigma_v);
            let (s, square) = (F::ONE - t[0] * u - t[1] * v, u * u + v * v);
            let exponent = F::of(-0.5) * square / (s * s + t[2] * t[2] * square);
            if s > F::ZERO && e.opacity.f64() * exponent.f64().exp() >= alpha_min {
                needed[pixel / 160 / 16 * 10 + pixel % 160 / 16] = 1;
            }
        }
        let listed = intersect_cpu(bound, &spec.intrinsics, alpha_min.into()).counts();
        assert!(
            needed.iter().zip(&listed).all(|(needed, listed)| needed <= listed),
            "{lens:?}: {row:?}, {t:?}: shows in {needed:?}, listed in {listed:?} by {bound:?}"
        );
        counts[0] += needed.iter().sum::<u32>() as usize;
        counts[1] += listed.iter().sum::<u32>() as usize;
    }
    counts
}

#[test]
fn bounds_hold_what_shows_and_little_more() {
    for lens in lenses() {
        for alpha_min in [1.0 / 255.0, 1e-6] {
            let [needed, listed] = check_tiles::<f64>(lens, 130.0, 0.9, alpha_min);
            check_tiles::<f32>(lens, 130.0, 0.9, alpha_min);
            println!("{lens:?}: {needed} needed, {listed} listed");
            // Large ones beside the picture, where the bound of the second derivative ends, are listed everywhere.
            assert!(needed > 800 && 5 * needed > listed, "{lens:?}: {needed} needed, {listed} listed");
        }
    }
    // Up to 88° from the axis: 55 px per radian.
    for lens in [(CameraModel::Fisheye, [0.0; 8]), lenses()[4]] {
        let [needed, listed] = check_tiles::<f64>(lens, 55.0, 4.0, 1.0 / 255.0);
        check_tiles::<f32>(lens, 55.0, 4.0, 1.0 / 255.0);
        println!("{lens:?}, wide: {needed} needed, {listed} listed");
        assert!(needed > 400 && 12 * needed > listed, "{lens:?}: {needed} needed, {listed} listed");
    }
}

#[cfg(feature = "cube")]
mod kernels {
    use super::*;
    use crate::gpu::Buffer;
    use crate::ray_space::cpu::ray_space_backward_cpu;
    use crate::ray_space::launch::{launch_bounds, launch_ray_space, launch_ray_space_backward};
    use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
    use crate::testing::gpu::gpus;

    const ALL: Geometry<bool> =
        Geometry { means: true, rotations: true, scales: true, opacities: false, cam_from_world: true, mean2d: false };

    const CULLED: u8 = 0;
    const ORDINARY: u8 = 1;

    fn list(g: Geometry<Vec<f64>>) -> Vec<Vec<f64>> {
        vec![g.means, g.rotations, g.scales, g.cam_from_world]
    }

    #[test]
    fn kernels_agree_with_the_twin() {
        for (seed, lens) in lenses().into_iter().enumerate() {
            let spec = spec(lens, f64::from(130.0f32));
            let mut tensors = scene(seed as u64, 600, 0.7);
            tensors.push(Random::new(7).fill(ROW * 600, -1.0, 1.0));
            let tensors: Vec<Vec<f64>> = tensors.iter().map(|tensor| rounded(tensor)).collect();
            let classes: Vec<Option<u8>> =
                (0..600).map(|i| Some(if i % 16 == 15 { CULLED } else { ORDINARY })).collect();
            let forward = PerturbedReference::new(&tensors, |tensors| vec![ray_space_cpu(inputs(tensors), &spec)]);
            let backward = PerturbedReference::new(&tensors, |tensors| {
                list(ray_space_backward_cpu(inputs(tensors), &tensors[5], &spec, ALL))
            });
            for (form, gpu) in gpus() {
                let what = |what: &str| format!("{what}, {form}, {lens:?}");
                let buffer = |i: usize| Buffer::from_slice(&gpu, &to_f32(&tensors[i]));
                let device = Geometry {
                    means: buffer(0),
                    rotations: buffer(1),
                    scales: buffer(2),
                    opacities: buffer(3),
                    cam_from_world: buffer(4),
                    mean2d: Buffer::new(&gpu, 0),
                };
                let found = launch_ray_space(&gpu, &device, &spec).read(&gpu);
                forward.check(&what("rows"), 0, &found, &classes);
                let g = launch_ray_space_backward(&gpu, &device, &buffer(5), &spec, ALL);
                for (i, found) in [g.means, g.rotations, g.scales].into_iter().enumerate() {
                    let name = what(["means", "rotations", "scales"][i]);
                    let found = found.expect("asked for").read(&gpu);
                    backward.check_gradient(&name, i, &found, &classes, &[CULLED, ORDINARY]);
                }
                let pose = g.cam_from_world.expect("asked for").read(&gpu);
                backward.check(&what("pose"), 3, &pose, &[Some(ORDINARY); 12]);
            }
        }
    }

    /// Rows agree except where a decision (misses the picture, is not known) may fall either way.
    #[test]
    fn bounds_agree_with_the_twin() {
        for lens in lenses() {
            let project = spec(lens, 130.0);
            let spec = RasterizeSpec { intrinsics: project.intrinsics, options: project.options };
            let tensors = scene(4, 800, 1.0);
            let packed = to_f32(&project_cpu(inputs(&tensors), &project));
            let slopes = to_f32(&ray_space_cpu(inputs(&tensors), &project));
            let expected = bounds_cpu(&packed, &slopes, &spec);
            for (form, gpu) in gpus() {
                let [packed, slopes] = [&packed, &slopes].map(|values| Buffer::from_slice(&gpu, values));
                let found = launch_bounds(&gpu, &packed, &slopes, &spec).read(&gpu);
                let off = found.chunks(COLUMNS).zip(expected.chunks(COLUMNS)).filter(|(found, expected)| {
                    let size = expected[2].abs() + expected[4].abs();
                    let near = |k: usize| (found[k] - expected[k]).abs() <= 1e-3 * (size + expected[k].abs());
                    !(0..COLUMNS).all(|k| if expected[6] == 0.0 { found[6] == 0.0 } else { near(k) })
                });
                let off = off.count();
                assert!(off <= 4, "{form}, {lens:?}: {off} of 800 rows differ");
                assert!(expected.chunks(COLUMNS).filter(|row| row[6] > 0.0 && row[2] < 100.0).count() > 300);
            }
        }
    }
}
