//! `project`: central finite differences, and culling.

use super::cpu::{project_backward_cpu, project_cpu};
use super::{COLUMNS, COMPENSATION_MIN, Geometry, ProjectSpec};
use crate::camera::{CameraModel, Intrinsics};
use crate::options::RenderOptions;
use crate::simd::Real;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::lenses::{FOX, ORTHOGRAPHIC, lenses};
use crate::testing::random::Random;

const ALL: Geometry<bool> =
    Geometry { means: true, rotations: true, scales: true, opacities: true, cam_from_world: true, mean2d: true };

fn spec(antialias: bool) -> ProjectSpec {
    let intrinsics = Intrinsics { fx: 35.0, fy: 31.0, cx: 18.0, cy: 15.5, ..Intrinsics::centred(40, 28, 35.0) };
    ProjectSpec { intrinsics, options: RenderOptions::standard().with_antialias(antialias), factors: false }
}

fn with_lens(spec: ProjectSpec, (model, distortion): (CameraModel, [f64; 8])) -> ProjectSpec {
    ProjectSpec { intrinsics: Intrinsics { model, distortion, ..spec.intrinsics }, ..spec }
}

/// Inputs on the host, in the order of the stage: means, rotations, scales, opacities and pose.
#[derive(Clone)]
struct StageInputs([Vec<f64>; 5]);

impl StageInputs {
    /// Gaussians in view, beyond each of the four limits of the Jacobian, thin as needles, and much smaller than a pixel.
    fn random(seed: u64, count: usize) -> Self {
        let mut random = Random::new(seed);
        let mut means = Vec::new();
        for i in 0..count {
            let z = random.between(2.0, 5.0);
            // The limits lie at slopes of -0.69 and 0.80 along x, -0.64 and 0.54 along y.
            let [x, y] = match i % 5 {
                0 => [1.3, random.between(-0.3, 0.3)],
                1 => [-1.2, 0.9],
                2 => [random.between(-0.3, 0.3), -1.1],
                _ => [random.between(-0.4, 0.4), random.between(-0.4, 0.4)],
            };
            means.extend([x * z, y * z, z]);
        }
        let mut scales = random.fill(3 * count, 0.05, 0.6);
        if count > 4 {
            scales[9] = 3.0;
            scales[10..12].fill(3e-3);
            scales[12..15].fill(2e-4);
        }
        let rotations = random.fill(4 * count, -1.5, 1.5);
        let opacities = random.fill(count, 0.1, 1.0);
        // Not quite a rotation: every entry of the pose is a free variable.
        let mut pose = vec![1.0, 0.02, -0.05, 0.1, -0.03, 0.98, 0.04, -0.2, 0.06, -0.02, 1.03, 0.3];
        pose.iter_mut().for_each(|entry| *entry += random.between(-0.01, 0.01));
        Self([means, rotations, scales, opacities, pose])
    }

    fn project(&self, spec: &ProjectSpec) -> Vec<f64> {
        project_cpu(inputs(&self.0), spec)
    }

    fn backward(&self, grad: &[f64], spec: &ProjectSpec, needs: Geometry<bool>) -> Geometry<Vec<f64>> {
        project_backward_cpu(inputs(&self.0), grad, spec, needs)
    }
}

fn inputs<F>([means, rotations, scales, opacities, cam_from_world]: &[Vec<F>; 5]) -> Geometry<&'_ [F]> {
    Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
}

fn check_every_gradient(what: &str, scene: &StageInputs, spec: &ProjectSpec, grad: &[f64]) -> Geometry<Vec<f64>> {
    let g = scene.backward(grad, spec, ALL);
    let gradients = [&g.means, &g.rotations, &g.scales, &g.opacities, &g.cam_from_world];
    let names = ["means", "rotations", "scales", "opacities", "pose"];
    for (i, (name, gradient)) in names.into_iter().zip(gradients).enumerate() {
        check_gradient(&format!("{name}, {what}"), &scene.0[i], gradient, 1, |moved| {
            let mut scene = scene.clone();
            scene.0[i] = moved.to_vec();
            inner_product(&scene.project(spec), grad)
        });
    }
    g
}

#[test]
fn every_gradient_agrees_with_finite_differences() {
    for (seed, antialias) in [(1, false), (2, true), (3, false), (4, true)] {
        let (scene, spec) = (StageInputs::random(seed, 20), spec(antialias));
        let grad = Random::new(seed + 100).fill(20 * COLUMNS, -1.0, 1.0);
        let g = check_every_gradient(&format!("antialias {antialias}"), &scene, &spec, &grad);
        let centres: Vec<f64> = grad.chunks_exact(COLUMNS).flat_map(|row| [row[0], row[1]]).collect();
        assert_eq!(g.mean2d, centres, "the probe gets the gradient at the projected centres");
    }
}

#[test]
fn every_gradient_through_every_lens_agrees_with_finite_differences() {
    for (i, lens) in lenses().into_iter().chain([ORTHOGRAPHIC]).enumerate() {
        for antialias in [false, true] {
            let (scene, spec) = (StageInputs::random(20 + i as u64, 20), with_lens(spec(antialias), lens));
            let grad = Random::new(120 + i as u64).fill(20 * COLUMNS, -1.0, 1.0);
            check_every_gradient(&format!("{lens:?}, antialias {antialias}"), &scene, &spec, &grad);
        }
    }
}

/// Gaussians on the axis, within rounding of it, near it, and almost at 90° from it.
#[test]
fn a_fisheye_is_smooth_on_its_axis_and_to_its_rim() {
    let mut scene = StageInputs::random(30, 8);
    let places = [
        [0.0, 0.0, 2.0],
        [1e-160, 0.0, 2.0],
        [1e-12, -1e-13, 2.0],
        [2e-6, 1e-6, 2.0],
        [1e-3, -2e-3, 2.0],
        [2.0, 1.0, 0.5],
        [2.0, -1.0, 0.05],
        [-1.0, 2.0, 0.02],
    ];
    scene.0[0] = places.concat();
    scene.0[2].fill(0.3);
    scene.0[4] = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let grad = Random::new(31).fill(8 * COLUMNS, -1.0, 1.0);
    for lens in lenses().into_iter().filter(|(model, _)| model.is_fisheye()) {
        let spec = with_lens(spec(false), lens);
        check_every_gradient(&format!("{lens:?}"), &scene, &spec, &grad);
        // On the axis a fisheye is a pinhole.
        let (row, pinhole) = (&scene.project(&spec)[..COLUMNS], &scene.project(&self::spec(false))[..COLUMNS]);
        for (found, expected) in row.iter().zip(pinhole) {
            assert!((found - expected).abs() <= 1e-13 * (1.0 + expected.abs()), "{row:?} {pinhole:?}");
        }
    }
}

#[test]
fn a_lens_without_coefficients_is_a_pinhole() {
    let (scene, spec) = (StageInputs::random(40, 20), spec(true));
    let pinhole = scene.project(&spec);
    for model in [CameraModel::OpenCv, CameraModel::FullOpenCv] {
        let found = scene.project(&with_lens(spec, (model, [0.0; 8])));
        for (found, expected) in found.iter().zip(&pinhole) {
            assert!((found - expected).abs() <= 1e-12 * (1.0 + expected.abs()), "{model:?}: {found} {expected}");
        }
    }
}

/// Along parallel rays nothing but the depth depends on the distance, and the picture is a scaled view along the axis.
#[test]
fn parallel_rays_know_no_distance() {
    let (mut scene, spec) = (StageInputs::random(60, 20), with_lens(spec(true), ORTHOGRAPHIC));
    scene.0[4] = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let rows = scene.project(&spec);
    for (row, mean) in rows.chunks_exact(COLUMNS).zip(scene.0[0].chunks_exact(3)) {
        assert_eq!(row[..2], [35.0 * mean[0] + 18.0, 31.0 * mean[1] + 15.5]);
        assert_eq!(row[5], mean[2]);
    }
    scene.0[0].iter_mut().skip(2).step_by(3).for_each(|z| *z *= 7.0);
    for (near, far) in rows.chunks_exact(COLUMNS).zip(scene.project(&spec).chunks_exact(COLUMNS)) {
        assert_eq!((&near[..5], near[6], 7.0 * near[5]), (&far[..5], far[6], far[5]));
    }
}

/// The lens of `fox_distorted` has a turning point at a slope of 1.34: without a limit, points far outside its view would be
/// folded back onto the picture.
#[test]
fn what_lies_beyond_the_reach_of_a_lens_is_not_folded_into_the_picture() {
    let mut scene = StageInputs::random(50, 8);
    scene.0[0] = (1..9).flat_map(|i| [0.45 * f64::from(i), 0.0, 1.0]).collect();
    scene.0[4] = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let spec = with_lens(spec(false), FOX);
    let shown: Vec<bool> = scene.project(&spec).chunks_exact(COLUMNS).map(|row| row[6] > 0.0).collect();
    assert_eq!(shown, [true, true, false, false, false, false, false, false]);
    let grads = scene.backward(&[1.0; 8 * COLUMNS], &spec, ALL);
    assert!(grads.means[6..].iter().all(|gradient| *gradient == 0.0));
}

#[test]
fn each_gradient_is_the_same_alone_and_nothing_else_is_computed() {
    let (scene, spec) = (StageInputs::random(5, 20), spec(true));
    let grad = Random::new(6).fill(20 * COLUMNS, -1.0, 1.0);
    let list = |g: Geometry<Vec<f64>>| [g.means, g.rotations, g.scales, g.opacities, g.cam_from_world, g.mean2d];
    let all = list(scene.backward(&grad, &spec, ALL));
    for alone in 0..6 {
        let [means, rotations, scales, opacities, cam_from_world, mean2d] = std::array::from_fn(|i| i == alone);
        let needs = Geometry { means, rotations, scales, opacities, cam_from_world, mean2d };
        for (i, gradient) in list(scene.backward(&grad, &spec, needs)).iter().enumerate() {
            let expected = if i == alone { all[i].as_slice() } else { &[] };
            assert_eq!(gradient, expected, "gradient {i}, asked for {alone}");
        }
    }
}

#[test]
fn the_factor_is_that_of_the_covariance() {
    let spec = spec(false);
    let mut scene = StageInputs::random(7, 1);
    // On the optical axis, with axes along the camera's and an identity pose, the variances are those of the axes, magnified.
    let pose = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    scene.0 = [vec![0.0, 0.0, 4.0], vec![2.0, 0.0, 0.0, 0.0], vec![0.4, 0.2, 9.0], vec![0.5], pose];
    let row = scene.project(&spec);
    let variance = |scale: f64, focal: f64| ((scale * focal / 4.0).powi(2) + spec.options.blur).sqrt();
    let expected = [18.0, 15.5, variance(0.4, 35.0), 0.0, variance(0.2, 31.0), 4.0, 0.5];
    for (found, expected) in row.iter().zip(expected) {
        let error = (found - expected).abs();
        assert!(error <= 1e-14 * (1.0 + expected.abs()), "found {row:?}");
    }
}

#[test]
fn compensation_holds_its_floor() {
    let (scene, spec) = (StageInputs::random(8, 20), spec(true));
    let row = &scene.project(&spec)[4 * COLUMNS..5 * COLUMNS];
    assert_eq!(row[6], scene.0[3][4] * COMPENSATION_MIN, "Gaussian 4 is much smaller than a pixel");
}

/// Makes the first Gaussians invalid, each in a different way, and returns their number.
fn spoil<F: Real>([means, rotations, scales, opacities, _]: &mut [Vec<F>; 5], not_finite: F) -> usize {
    means[0] = not_finite;
    rotations[4] = not_finite;
    scales[6] = not_finite;
    opacities[3] = not_finite;
    rotations[16..20].fill(F::ZERO);
    means[17] = F::of(-3.0);
    6
}

#[test]
fn bad_gaussians_are_culled_have_no_gradient_and_change_nothing_else() {
    for not_finite in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let (good, spec) = (StageInputs::random(9, 20), spec(true));
        let mut bad = good.clone();
        let spoilt = spoil(&mut bad.0, not_finite);
        let (good_rows, rows) = (good.project(&spec), bad.project(&spec));
        for row in rows[..spoilt * COLUMNS].chunks_exact(COLUMNS) {
            assert_eq!(row, [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
        }
        assert_eq!(rows[spoilt * COLUMNS..], good_rows[spoilt * COLUMNS..]);

        let grad = Random::new(10).fill(20 * COLUMNS, -1.0, 1.0);
        let (g, mut masked) = (bad.backward(&grad, &spec, ALL), grad);
        masked[..spoilt * COLUMNS].fill(0.0);
        let expected = good.backward(&masked, &spec, ALL);
        assert_eq!(g.means, expected.means);
        assert_eq!(g.rotations, expected.rotations);
        assert_eq!(g.scales, expected.scales);
        assert_eq!(g.opacities, expected.opacities);
        assert_eq!(g.cam_from_world, expected.cam_from_world);
        assert_eq!(g.mean2d, expected.mean2d);
    }
}

#[test]
fn extreme_scales_stay_finite_in_f32() {
    let scene = StageInputs::random(11, 20);
    let spec = spec(true);
    for log_scale in [-50.0_f64, -20.0, 20.0, 50.0] {
        let mut wild = scene.0.each_ref().map(|values| values.iter().map(|v| *v as f32).collect::<Vec<f32>>());
        // Extreme along one axis, then along all three.
        wild[2].iter_mut().step_by(6).for_each(|scale| *scale = log_scale.exp() as f32);
        wild[2][..9].fill(log_scale.exp() as f32);
        wild[1].iter_mut().for_each(|component| *component *= 1e-20);
        let rows = project_cpu(inputs(&wild), &spec);
        assert!(rows.iter().all(|value| value.is_finite()), "log scale {log_scale}: {rows:?}");
        let widths = rows.chunks_exact(COLUMNS).all(|row| row[2] > 0.0 && row[4] > 0.0);
        assert!(widths, "log scale {log_scale}: an ellipse without width");
        let g = project_backward_cpu(inputs(&wild), &vec![1e-3; rows.len()], &spec, ALL);
        for gradient in [&g.means, &g.scales, &g.opacities, &g.cam_from_world] {
            assert!(gradient.iter().all(|value| value.is_finite()), "log scale {log_scale}: {gradient:?}");
        }
    }
}
