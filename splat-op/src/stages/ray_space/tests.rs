//! Compares `ray_space` with a factorisation of the covariance and checks the bounds. `rasterize_rays` has the proof of its gradient.

use glam::{DMat3, DQuat, DVec3};

use super::cpu::{ray_space_backward_cpu, ray_space_cpu};
use super::{EXTENT, RAY_SPACE, THICKNESS_MAX, beyond, bounds_cpu};
use crate::camera::Intrinsics;
use crate::intersect::cpu::intersect_cpu;
use crate::options::{Projection, RenderOptions};
use crate::project::cpu::project_cpu;
use crate::project::{COLUMNS, Ellipse, Geometry, ProjectSpec};
use crate::rasterize::RasterizeSpec;
use crate::simd::Real;
use crate::testing::random::Random;

const ALL: Geometry<bool> =
    Geometry { means: true, rotations: true, scales: true, opacities: false, cam_from_world: true, mean2d: false };

const CAMERA: Intrinsics = Intrinsics { fx: 35.0, fy: 31.0, cx: 18.0, cy: 15.5, ..Intrinsics::centred(40, 28, 35.0) };

fn spec(blur: f64) -> ProjectSpec {
    let options = RenderOptions { blur, ..RenderOptions::standard() }.with_projection(Projection::RayMax);
    ProjectSpec { intrinsics: CAMERA, options: options.of_project(&CAMERA), factors: false }
}

/// Means, rotations, scales, opacities, pose.
#[derive(Clone)]
struct StageInputs([Vec<f64>; 5]);

impl StageInputs {
    /// Gaussians in view and far beside it, small and large relative to their distance, thin as needles, and flat.
    fn random(seed: u64, count: usize) -> Self {
        let mut random = Random::new(seed);
        let (mut means, mut scales) = (Vec::new(), Vec::new());
        for i in 0..count {
            let z = random.between(1.0, 5.0);
            let beside = if i % 4 == 0 { 2.5 } else { 0.5 };
            means.extend([random.between(-beside, beside) * z, random.between(-beside, beside) * z, z]);
            let size = [0.05, 0.6, 2.0][i % 3];
            let thin = if i % 5 == 1 { 5e-2 } else { 1.0 };
            scales.extend([size * thin, size * random.between(0.5, 1.5), size * if i % 10 == 1 { thin } else { 0.7 }]);
        }
        let mut pose = vec![1.0, 0.02, -0.05, 0.1, -0.03, 0.98, 0.04, -0.2, 0.06, -0.02, 1.03, 0.3];
        pose.iter_mut().for_each(|entry| *entry += random.between(-0.01, 0.01));
        Self([means, random.fill(4 * count, -1.5, 1.5), scales, vec![0.5; count], pose])
    }

    fn ray_rows(&self, spec: &ProjectSpec) -> Vec<f64> {
        ray_space_cpu(inputs(&self.0), spec)
    }
}

fn inputs<F>([means, rotations, scales, opacities, cam_from_world]: &[Vec<F>; 5]) -> Geometry<&'_ [F]> {
    Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
}

/// The covariance of the module's documentation, formed literally, in the coordinates of the picture's point next to the centre.
fn covariance(scene: &StageInputs, i: usize, blur: f64) -> DMat3 {
    let [means, rotations, scales, _, p] = &scene.0;
    let pose = DMat3::from_cols_array(&[p[0], p[4], p[8], p[1], p[5], p[9], p[2], p[6], p[10]]);
    let q = &rotations[4 * i..];
    let turn = DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize());
    let axes = pose * turn * DMat3::from_diagonal(DVec3::from_slice(&scales[3 * i..]));
    let DVec3 { x, y, z } = pose * DVec3::from_slice(&means[3 * i..]) + DVec3::new(p[3], p[7], p[11]);
    let (fx, fy) = (CAMERA.fx, CAMERA.fy);
    let [[low_x, high_x], [low_y, high_y]] = CAMERA.slope_limits(0.0);
    let (slope_x, slope_y) = ((x / z).clamp(low_x, high_x), (y / z).clamp(low_y, high_y));
    let map =
        DMat3::from_cols_array(&[fx / z, 0.0, 0.0, 0.0, fy / z, 0.0, -fx * slope_x / z, -fy * slope_y / z, 1.0 / z]);
    let m = map * axes;
    m * m.transpose() + DMat3::from_diagonal(DVec3::new(blur, blur, 0.0))
}

#[test]
fn it_is_the_last_row_of_the_factor() {
    for blur in [0.3, 0.0] {
        let (scene, spec) = (StageInputs::random(1, 200), spec(blur));
        let packed = project_cpu(inputs(&scene.0), &spec);
        for (i, (row, ray)) in
            packed.chunks_exact(COLUMNS).zip(scene.ray_rows(&spec).chunks_exact(RAY_SPACE)).enumerate()
        {
            let e = Ellipse::from_row(row);
            assert_eq!([e.sigma_u, e.shear, e.sigma_v], ray[6..]);
            let away = beyond(e.mean_px, &CAMERA).1;
            let centre = [1.0, away[0], away[1]].into_iter().zip(&ray[3..6]);
            centre.for_each(|(expected, found)| assert!((found - expected).abs() < 1e-11, "Gaussian {i}: {found}"));
            let u = DVec3::new(e.sigma_u, e.shear * e.sigma_u, ray[0]);
            let v = DVec3::new(0.0, e.sigma_v, ray[1]);
            let w = DVec3::new(0.0, 0.0, ray[2]);
            let factor = DMat3::from_cols(u, v, w);
            let (found, expected) = (factor * factor.transpose(), covariance(&scene, i, blur));
            // Depths are thousands of times smaller than pixels: each entry is compared relative to its row and column.
            for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
                let at = |m: &DMat3, row: usize, column: usize| m.col(column)[row];
                let size = (at(&expected, row, row) * at(&expected, column, column)).sqrt();
                let error = (at(&found, row, column) - at(&expected, row, column)).abs();
                assert!(error <= 1e-12 * size, "Gaussian {i}, entry {row}, {column}: {error:e} of {size:e}");
            }
        }
    }
}

#[test]
fn extreme_sizes_stay_finite_in_f32() {
    let mut scene = StageInputs::random(5, 40);
    for (i, scale) in scene.0[2].chunks_exact_mut(3).enumerate() {
        let size = [50.0_f64, -50.0][i % 2].exp();
        (0..3).filter(|axis| ((i / 2) >> axis) & 1 == 0).for_each(|axis| scale[axis] = size);
    }
    scene.0[0][2] = -4.0;
    scene.0[0][3] = f64::NAN;
    let single = scene.0.each_ref().map(|values| values.iter().map(|v| *v as f32).collect::<Vec<f32>>());
    for blur in [0.3, 0.0] {
        let spec = spec(blur);
        let ray_rows = ray_space_cpu(inputs(&single), &spec);
        assert!(ray_rows.iter().all(|value| value.is_finite()), "{ray_rows:?}");
        assert!(ray_rows[..2 * RAY_SPACE].iter().all(|value| *value == 0.0), "behind the camera, and nowhere");
        assert!(ray_rows.chunks_exact(RAY_SPACE).any(|row| f64::from(row[2]) == f64::from(THICKNESS_MAX as f32)));
        let g = ray_space_backward_cpu(inputs(&single), &vec![1.0; ray_rows.len()], &spec, ALL);
        for (name, gradient) in [("means", g.means), ("rotations", g.rotations), ("scales", g.scales)] {
            assert!(gradient.iter().all(|value| value.is_finite()), "{name}: {gradient:?}");
        }
    }
}

/// Checks that the bounds contain the visible region of a Gaussian and, where that region is bounded, are not much larger.
fn check_bounds<F: Real>(seed: u64) {
    let mut random = Random::new(seed);
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let spec = RasterizeSpec { intrinsics: Intrinsics::centred(640, 480, 500.0), options };
    let mut bounded = 0;
    for _ in 0..2000 {
        let e = Ellipse {
            mean_px: [random.between(0.0, 640.0), random.between(0.0, 480.0)],
            sigma_u: random.between(0.5, 30.0),
            shear: random.between(-2.0, 2.0),
            sigma_v: random.between(0.5, 30.0),
            depth: 2.0,
            opacity: random.between(0.004, 1.0),
        };
        let steep = random.between(0.0, 0.5);
        let depth_slope = [random.between(-steep, steep), random.between(-steep, steep), random.between(0.0, 0.4)];
        let row: Vec<F> = e.to_row().map(F::of).to_vec();
        let slopes: Vec<F> = depth_slope.into_iter().chain([0.0; 6]).map(F::of).collect();
        let found = Ellipse::from_row(&bounds_cpu(&row, &slopes, &spec)).to_row().map(|value| value.f64());
        let found = Ellipse::from_row(&found);
        let all = found.sigma_u >= 1000.0;
        bounded += usize::from(!all);
        assert!(found.depth == e.depth && found.opacity > options.alpha_min);
        let (mut farthest, mut held) = (0.0_f64, true);
        for turn in 0..64 {
            let (sin, cos) = (turn as f64 * std::f64::consts::TAU / 64.0).sin_cos();
            // Walks outwards along a ray as far as the Gaussian is visible.
            for step in 0..330 {
                let r = 0.02 * 1.03_f64.powi(step);
                let (u, v) = (r * cos, r * sin);
                let s = 1.0 - depth_slope[0] * u - depth_slope[1] * v;
                let alpha = e.opacity * (-0.5 * r * r / (s * s + (depth_slope[2] * r).powi(2))).exp();
                if !(s > 0.0 && alpha >= options.alpha_min) {
                    continue;
                }
                let px = [e.mean_px[0] + e.sigma_u * u, e.mean_px[1] + e.sigma_u * e.shear * u + e.sigma_v * v];
                let [x, y] = [px[0] - found.mean_px[0], px[1] - found.mean_px[1]];
                let extent = (x / found.sigma_u).hypot((y - found.shear * x) / found.sigma_v) / EXTENT;
                farthest = farthest.max(extent);
                // A row may leave out what lies beyond the picture.
                let beyond = !(0.0..=640.0).contains(&px[0]) || !(0.0..=480.0).contains(&px[1]);
                held &= extent <= 1.0 || beyond;
            }
        }
        assert!(held, "{e:?}, depth slope {depth_slope:?} shows beyond {found:?}: {farthest}");
        // The bounds touch the visible region, up to the step of the walk and the slack, which matters where a Gaussian is hardly
        // visible or visible almost everywhere.
        let telling = e.opacity < 0.05 || found.sigma_u > 10.0 * e.sigma_u;
        assert!(telling || farthest > 0.93, "{e:?}, depth slope {depth_slope:?}: {found:?} is too large, {farthest}");
    }
    assert!(bounded > 500 && bounded < 1900, "{bounded} of 2000 have an end");
}

#[test]
fn bounds_hold_what_shows_and_little_more() {
    check_bounds::<f64>(1);
    check_bounds::<f32>(2);
}

/// Long thin Gaussians, most of them beside the camera and partly behind it.
fn beside(seed: u64, count: usize) -> StageInputs {
    let mut random = Random::new(seed);
    let mut scene = StageInputs::random(seed, count);
    for i in 0..count {
        let z = random.between(-4.0, 0.0).exp();
        scene.0[0][3 * i..3 * i + 3].copy_from_slice(&[random.between(-4.0, 4.0), random.between(-4.0, 4.0), z]);
        let long = random.between(-2.0, 2.0).exp();
        let thin = long * random.between(-5.0, -1.0).exp();
        scene.0[2][3 * i..3 * i + 3].copy_from_slice(&[long, thin, thin * random.between(0.1, 1.0)]);
    }
    scene
}

/// Checks the tiles of Gaussians beside the camera against all pixels, evaluated in `F` as `rasterize_rays` does. Returns the
/// numbers of tiles that are needed, that the bounds list, and that Gaussians which cover the picture would list.
fn check_tiles<F: Real>(seed: u64, alpha_min: f64) -> [usize; 3] {
    let scene = beside(seed, 600);
    let mut project = spec(0.3);
    project.intrinsics = Intrinsics::centred(160, 112, 130.0);
    let options = RenderOptions { alpha_min, ..RenderOptions::standard().with_projection(Projection::RayMax) };
    let spec = RasterizeSpec { intrinsics: project.intrinsics, options };
    let of = |values: Vec<f64>| values.into_iter().map(F::of).collect::<Vec<F>>();
    let (packed, ray_rows) = (of(project_cpu(inputs(&scene.0), &project)), of(scene.ray_rows(&project)));
    let bounds = bounds_cpu(&packed, &ray_rows, &spec);
    let tiles = |rows: &[F]| intersect_cpu(rows, &spec.intrinsics, alpha_min.into()).counts();
    let mut counts = [0; 3];
    for ((row, bound), t) in packed.chunks(COLUMNS).zip(bounds.chunks(COLUMNS)).zip(ray_rows.chunks(RAY_SPACE)) {
        let e = Ellipse::from_row(row);
        if !(e.depth > F::ZERO) {
            continue;
        }
        let (base, away) = beyond(e.mean_px, &spec.intrinsics);
        let mut needed = vec![0; 70];
        for (x, y) in (0..112).flat_map(|y| (0..160).map(move |x| (x, y))) {
            let whitened = |[dx, dy]: [F; 2]| {
                let (u, v) = (dx / e.sigma_u, (dy - e.shear * dx) / e.sigma_v);
                [u, v, F::ONE - t[0] * u - t[1] * v]
            };
            let [u, v, s] = whitened([F::of(x as f64 + 0.5) - base[0], F::of(y as f64 + 0.5) - base[1]]);
            let [of_u, of_v, of_s] = whitened(away);
            let (dot, square, thick) = (u * of_u + v * of_v, u * u + v * v, t[2] * t[2]);
            let d = s * s + thick * square;
            let lambda = (s * of_s + thick * dot) / d;
            let (apart_u, apart_v) = (of_u - lambda * u, of_v - lambda * v);
            let apart_s = (of_s * square - s * dot) / d;
            let exponent = apart_u * apart_u + apart_v * apart_v + thick * apart_s * apart_s;
            let alpha = e.opacity * F::of((-0.5 * exponent.f64()).exp());
            if lambda > F::ZERO && alpha >= F::of(alpha_min) {
                needed[y / 16 * 10 + x / 16] = 1;
            }
        }
        let listed = tiles(bound);
        assert!(
            needed.iter().zip(&listed).all(|(needed, listed)| needed <= listed),
            "{row:?}, depth slope {t:?}: shows in {needed:?}, listed in {listed:?} by {bound:?}"
        );
        counts[0] += needed.iter().sum::<u32>() as usize;
        counts[1] += listed.iter().sum::<u32>() as usize;
        counts[2] += 70;
    }
    counts
}

#[test]
fn bounds_beside_the_camera_hold_what_shows_and_little_more() {
    for alpha_min in [1.0 / 255.0, 1e-6] {
        for seed in 20..24 {
            let [needed, listed, all] = check_tiles::<f64>(seed, alpha_min);
            assert_eq!(check_tiles::<f32>(seed, alpha_min)[2], all);
            assert!(
                needed > 500 && 2 * needed > listed && all > 4 * listed,
                "{needed} of {all} needed, {listed} listed"
            );
        }
    }
}

#[test]
fn what_is_culled_or_too_faint_keeps_its_row() {
    let options = RenderOptions::standard().with_projection(Projection::RayMax);
    let spec = RasterizeSpec { intrinsics: CAMERA, options };
    let rows = [[0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0], [5.0, 6.0, 2.0, 0.1, 1.5, 3.0, 0.003]].concat();
    assert_eq!(bounds_cpu(&rows, &[0.1; 2 * RAY_SPACE], &spec), rows);
}
