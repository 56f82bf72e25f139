//! Visibility against colours of all Gaussians, and against the lists of `intersect`.

use super::cpu::{ShCpuInputs, Visible, sh_backward_cpu, sh_cpu};
use super::{Shading, extent_sigmas};
use crate::camera::Intrinsics;
use crate::intersect::cpu::intersect_cpu;
use crate::options::RenderOptions;
use crate::project::cpu::project_cpu;
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::simd::Real;
use crate::testing::random::Random;

/// Number of coefficients per channel, degree 2.
pub(super) const COEFFICIENTS: usize = 9;

pub(super) fn spec(alpha_min: f64) -> ProjectSpec {
    let intrinsics = Intrinsics { fx: 60.0, fy: 64.0, cx: 33.0, cy: 27.5, ..Intrinsics::centred(70, 52, 60.0) };
    ProjectSpec { intrinsics, options: RenderOptions { alpha_min, ..RenderOptions::standard() }, factors: false }
}

/// Means, rotations, scales, opacities, harmonics, pose and gradient of the colours.
pub(super) struct StageInputs(pub Vec<Vec<f64>>);

impl StageInputs {
    /// Gaussians in view, across each border, far outside the picture, and behind the camera. Some are thin, some lie along a
    /// diagonal, some are too faint to show, some have an opacity above one, and one in seven has no gradient.
    pub fn random(seed: u64, count: usize) -> Self {
        let mut random = Random::new(seed);
        let mut means = Vec::new();
        for i in 0..count {
            let z = random.between(0.5, 6.0) * if i % 9 == 4 { -1.0 } else { 1.0 };
            let reach = [0.5, 0.8, 1.5, 6.0][i % 4];
            means.extend([reach * random.between(-1.0, 1.0) * z, reach * random.between(-1.0, 1.0) * z, z]);
        }
        let mut scales = random.fill(3 * count, 0.01, 0.25);
        scales.iter_mut().step_by(5).for_each(|scale| *scale *= 1e-2);
        let opacities = (0..count).map(|i| [0.9, 0.3, 2e-3, 0.6, 1.5][i % 5] * random.between(0.7, 1.1)).collect();
        let pose = vec![0.8, 0.0, -0.6, 0.1, -0.36, 0.8, -0.48, -0.2, 0.48, 0.6, 0.64, 0.3];
        let mut colours = random.fill(3 * count, -1.0, 1.0);
        colours.chunks_mut(3).step_by(7).for_each(|row| row.fill(0.0));
        let rotations = random.fill(4 * count, -1.0, 1.0);
        let sh = random.fill(3 * COEFFICIENTS * count, -0.6, 0.6);
        // From the camera's frame to the world frame, by the transposed rotation.
        let world = means.chunks_exact(3).flat_map(|m| {
            let along = [0, 1, 2].map(|row| m[row] - pose[4 * row + 3]);
            [0, 1, 2].map(|axis| (0..3).map(|row| pose[4 * row + axis] * along[row]).sum::<f64>())
        });
        Self(vec![world.collect(), rotations, scales, opacities, sh, pose.clone(), colours])
    }

    pub fn geometry(&self) -> Geometry<&'_ [f64]> {
        let [means, rotations, scales, opacities, _, cam_from_world, _] = &self.0[..] else { unreachable!() };
        Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
    }

    pub fn inputs(&self) -> ShCpuInputs<'_, f64> {
        let (sh, means, cam_from_world) = (&self.0[4][..], &self.0[0][..], &self.0[5][..]);
        ShCpuInputs { sh, means, cam_from_world, coefficients: COEFFICIENTS }
    }

    pub fn grad(&self) -> &[f64] {
        &self.0[6]
    }
}

/// Asserts that each colour is that of `expected` or zero, and that of `expected` if the Gaussian is in a list. Returns the number
/// of Gaussians in front of the camera that were skipped.
pub(super) fn check_colours<F: Real>(
    packed: &[F],
    found: &[F],
    spec: &ProjectSpec,
    same: impl Fn(usize) -> bool,
) -> usize {
    // With an `alpha_min` of zero every Gaussian is in every list, although most contribute exactly zero.
    let lists = intersect_cpu(packed, &spec.intrinsics, spec.options.alpha_min.max(1e-37).into());
    let mut skipped = 0;
    for (i, row) in packed.chunks_exact(COLUMNS).enumerate() {
        let zero = found[3 * i..3 * i + 3].iter().all(|value| *value == F::ZERO);
        let listed = lists.visible.contains(&(i as u32));
        assert!(same(i) || (zero && !listed), "Gaussian {i}, listed: {listed}");
        skipped += usize::from(zero && !same(i) && row[5] > F::ZERO);
    }
    assert!(!lists.visible.is_empty());
    skipped
}

#[test]
fn colours_are_those_of_all_or_zero_where_nothing_can_show() {
    for (seed, alpha_min) in [(1, 1.0 / 255.0), (2, 0.05), (3, 1e-12), (4, 0.0)] {
        let (scene, spec) = (StageInputs::random(seed, 2_000), spec(alpha_min));
        let packed = project_cpu(scene.geometry(), &spec);
        let colours = sh_cpu(scene.inputs(), Some(&Visible::new(&packed, &spec)));
        let expected = sh_cpu(scene.inputs(), None);
        let same = |i: usize| colours[3 * i..3 * i + 3] == expected[3 * i..3 * i + 3];
        let skipped = check_colours(&packed, &colours, &spec, same);
        assert!(skipped > 100, "only {skipped} of 2000 were left out: this shows nothing");
    }
}

#[test]
fn without_a_smallest_alpha_only_what_rounds_to_nothing_is_left_out() {
    assert!((-0.5 * extent_sigmas(0.0).powi(2)).exp() == 0.0);
    assert!(extent_sigmas(1e-300) < extent_sigmas(0.0));
    // The tiles in which `intersect` lists a Gaussian whose opacity equals `alpha_min`.
    assert!(extent_sigmas(1.0) > 1e-4_f64.sqrt() && extent_sigmas(2.0) == extent_sigmas(1.0));
}

#[test]
fn harmonics_of_what_cannot_show_are_not_read() {
    let (mut scene, spec) = (StageInputs::random(5, 500), spec(1.0 / 255.0));
    let packed = project_cpu(scene.geometry(), &spec);
    let visible = Visible::new(&packed, &spec);
    let expected = sh_cpu(scene.inputs(), Some(&visible));
    for (colour, sh) in expected.chunks_exact(3).zip(scene.0[4].chunks_exact_mut(3 * COEFFICIENTS)) {
        if colour.iter().all(|value| *value == 0.0) {
            sh.fill(f64::NAN);
        }
    }
    let grad = vec![1.0; 1_500];
    let needs = Shading { sh: true, means: true, cam_from_world: true };
    let found = sh_backward_cpu(scene.inputs(), Some(&visible), &grad, needs);
    assert!(sh_cpu(scene.inputs(), Some(&visible)) == expected);
    assert!([found.sh, found.means, found.cam_from_world].iter().flatten().all(|g| g.is_finite()));
}

#[test]
fn gradients_are_those_of_all_without_the_colours_that_cannot_show() {
    let (scene, spec) = (StageInputs::random(4, 2_000), spec(1.0 / 255.0));
    let packed = project_cpu(scene.geometry(), &spec);
    let visible = Visible::new(&packed, &spec);
    let colours = sh_cpu(scene.inputs(), Some(&visible));
    let (all, mut shown) = (sh_cpu(scene.inputs(), None), scene.grad().to_vec());
    let mut hidden = 0;
    for (i, grad) in shown.chunks_exact_mut(3).enumerate() {
        if colours[3 * i..3 * i + 3] != all[3 * i..3 * i + 3] {
            hidden += usize::from(grad.iter().any(|g| *g != 0.0));
            grad.fill(0.0);
        }
    }
    assert!(hidden > 100, "only {hidden} of 2000 have a gradient to lose: this shows nothing");
    for choice in 0..8_u32 {
        let [sh, means, cam_from_world] = std::array::from_fn(|i| choice >> i & 1 != 0);
        let needs = Shading { sh, means, cam_from_world };
        let found = sh_backward_cpu(scene.inputs(), Some(&visible), scene.grad(), needs);
        let expected = sh_backward_cpu(scene.inputs(), None, &shown, needs);
        assert!(found.sh == expected.sh && found.means == expected.means, "choice {choice}");
        assert!(found.cam_from_world == expected.cam_from_world, "choice {choice}");
    }
}
