//! Both stages in one against the stages alone, which are proven on their own.

use super::cpu::{Inputs, project_shade_backward_cpu, project_shade_cpu};
use super::{ProjectShadeNeeds, reach_sigmas};
use crate::camera::Intrinsics;
use crate::options::RenderOptions;
use crate::project::cpu::{Inputs as ProjectInputs, project_backward_cpu, project_cpu};
use crate::project::{COLUMNS, ProjectNeeds, ProjectSpec};
use crate::shade::ShadeNeeds;
use crate::shade::cpu::{Coefficients, Inputs as ShadeInputs, shade_backward_cpu, shade_cpu};
use crate::testing::random::Random;
use crate::tile::cpu::tile_cpu;

/// Harmonics per channel, of degree 2.
pub(super) const COEFFICIENTS: usize = 9;

pub(super) fn spec(alpha_min: f64) -> ProjectSpec {
    let intrinsics = Intrinsics { fx: 60.0, fy: 64.0, cx: 33.0, cy: 27.5, ..Intrinsics::centred(70, 52, 60.0) };
    ProjectSpec { intrinsics, options: RenderOptions { alpha_min, ..RenderOptions::standard() } }
}

/// Means, rotations, scales, opacities, harmonics, pose, gradient of the ellipses, gradient of the colours.
pub(super) struct Scene(pub Vec<Vec<f64>>);

impl Scene {
    /// Gaussians in view, across each border, far beside the picture, and behind the camera; some thin, some turned along a
    /// diagonal, some too faint to show, some of an opacity above one, one in seven without a gradient.
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
        let mut grads = [random.fill(COLUMNS * count, -1.0, 1.0), random.fill(3 * count, -1.0, 1.0)];
        for (grad, columns) in grads.iter_mut().zip([COLUMNS, 3]) {
            grad.chunks_mut(columns).step_by(7).for_each(|row| row.fill(0.0));
        }
        let [ellipses, colours] = grads;
        let rotations = random.fill(4 * count, -1.0, 1.0);
        let sh = random.fill(3 * COEFFICIENTS * count, -0.6, 0.6);
        // From the camera's frame to the world, by the inverse of a rotation.
        let world = means.chunks_exact(3).flat_map(|m| {
            let along = [0, 1, 2].map(|row| m[row] - pose[4 * row + 3]);
            [0, 1, 2].map(|axis| (0..3).map(|row| pose[4 * row + axis] * along[row]).sum::<f64>())
        });
        Self(vec![world.collect(), rotations, scales, opacities, sh, pose.clone(), ellipses, colours])
    }

    pub fn inputs(&self) -> Inputs<'_, f64> {
        let [means, rotations, scales, opacities, sh, cam_from_world, ..] = &self.0[..] else { unreachable!() };
        let geometry = ProjectInputs { means, rotations, scales, opacities, cam_from_world };
        Inputs { geometry, sh: Coefficients::Full(sh), coefficients: COEFFICIENTS, matte: None }
    }

    fn shade_inputs(&self) -> ShadeInputs<'_, f64> {
        ShadeInputs {
            sh: Coefficients::Full(&self.0[4]),
            means: &self.0[0],
            cam_from_world: &self.0[5],
            coefficients: COEFFICIENTS,
        }
    }
}

/// Gaussians of which the last ones are matte, in both ways to say so.
pub(super) struct Parted {
    /// All of one degree, with coefficients of zero.
    pub flat: Scene,
    /// Coefficients of the first, `[M, COEFFICIENTS, 3]`, and of the others, `[N − M, 1, 3]`.
    pub sh: Vec<f64>,
    pub matte: Vec<f64>,
}

impl Parted {
    pub fn new(mut flat: Scene, matte: usize) -> Self {
        let first = flat.0[4].len() - 3 * COEFFICIENTS * matte;
        flat.0[4][first..].chunks_mut(3 * COEFFICIENTS).for_each(|row| row[3..].fill(0.0));
        let (sh, rows) = flat.0[4].split_at(first);
        let (sh, matte) = (sh.to_vec(), constant_of(rows));
        Self { flat, sh, matte }
    }

    fn inputs(&self) -> Inputs<'_, f64> {
        let (sh, matte) = (Coefficients::Full(&self.sh[..]), Coefficients::Full(&self.matte[..]));
        Inputs { sh, matte: Some(matte), ..self.flat.inputs() }
    }
}

/// The coefficients of degree 0 in rows of all.
pub(super) fn constant_of<F: Copy>(rows: &[F]) -> Vec<F> {
    rows.chunks_exact(3 * COEFFICIENTS).flat_map(|row| &row[..3]).copied().collect()
}

/// How many Gaussians, and how many of them are matte: within a task, across tasks, almost all.
pub(super) const PARTED: [(usize, usize); 3] = [(1_500, 700), (2_100, 1), (300, 299)];

/// Asserts that colours are those of `expected` or zero, and of `expected` where a Gaussian is in a list; returns how many of
/// those in front of the camera were left out.
pub(super) fn check_colours<F: crate::real::Real>(
    packed: &[F],
    found: &[F],
    spec: &ProjectSpec,
    same: impl Fn(usize) -> bool,
) -> usize {
    // Without a smallest alpha every Gaussian is in every list, though most of them add exactly nothing.
    let lists = tile_cpu(packed, &spec.intrinsics, spec.options.alpha_min.max(1e-37).into());
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
fn forwards_it_is_the_stages_but_for_colours_that_cannot_show() {
    for (seed, alpha_min) in [(1, 1.0 / 255.0), (2, 0.05), (3, 1e-12), (4, 0.0)] {
        let (scene, spec) = (Scene::random(seed, 2_000), spec(alpha_min));
        let (packed, colours) = project_shade_cpu(scene.inputs(), &spec);
        assert!(packed == project_cpu(scene.inputs().geometry, &spec));
        let expected = shade_cpu(scene.shade_inputs());
        let same = |i: usize| colours[3 * i..3 * i + 3] == expected[3 * i..3 * i + 3];
        let skipped = check_colours(&packed, &colours, &spec, same);
        assert!(skipped > 100, "only {skipped} of 2000 were left out: this shows nothing");
    }
}

#[test]
fn without_a_smallest_alpha_only_what_rounds_to_nothing_is_left_out() {
    assert!((-0.5 * reach_sigmas(0.0).powi(2)).exp() == 0.0);
    assert!(reach_sigmas(1e-300) < reach_sigmas(0.0));
    // What `tile` lists of a Gaussian whose opacity is the smallest alpha.
    assert!(reach_sigmas(1.0) > 1e-4_f64.sqrt() && reach_sigmas(2.0) == reach_sigmas(1.0));
}

#[test]
fn backwards_it_is_the_sum_of_the_stages_for_any_choice_of_gradients() {
    let (scene, spec) = (Scene::random(4, 2_000), spec(1.0 / 255.0));
    let (of_ellipses, of_colours) = (&scene.0[6][..], &scene.0[7][..]);
    for choice in 0..64_u32 {
        let [means, rotations, scales, opacities, mean2d, sh] = std::array::from_fn(|i| choice >> i & 1 != 0);
        let geometry = ProjectNeeds { means, rotations, scales, opacities, mean2d, cam_from_world: false };
        let needs = ProjectShadeNeeds { geometry, sh, matte: false };
        let found = project_shade_backward_cpu(scene.inputs(), (of_ellipses, of_colours), &spec, needs);
        let one = project_backward_cpu(scene.inputs().geometry, of_ellipses, &spec, geometry);
        let shade_needs = ShadeNeeds { sh, means, cam_from_world: false };
        let other = shade_backward_cpu(scene.shade_inputs(), of_colours, shade_needs);
        let sum: Vec<f64> = one.means.iter().zip(&other.means).map(|(a, b)| a + b).collect();
        assert!(found.geometry.means == sum && found.sh == other.sh, "choice {choice}");
        let g = found.geometry;
        assert!(g.rotations == one.rotations && g.scales == one.scales && g.opacities == one.opacities);
        assert!(g.mean2d == one.mean2d && g.cam_from_world.is_empty());
    }
}

#[test]
fn matte_gaussians_are_those_without_higher_harmonics_bit_for_bit() {
    let spec = spec(1.0 / 255.0);
    for (count, matte) in PARTED {
        let parted = Parted::new(Scene::random(count as u64, count), matte);
        let (inputs, flat) = (parted.inputs(), parted.flat.inputs());
        assert!(project_shade_cpu(inputs, &spec) == project_shade_cpu(flat, &spec), "{matte} of {count}");
        let grads = (&parted.flat.0[6][..], &parted.flat.0[7][..]);
        for choice in 0..8_u32 {
            let [means, sh, matte] = std::array::from_fn(|i| choice >> i & 1 != 0);
            let geometry = ProjectNeeds {
                means,
                rotations: true,
                scales: true,
                opacities: true,
                mean2d: true,
                cam_from_world: false,
            };
            let needs = ProjectShadeNeeds { geometry, sh, matte };
            let found = project_shade_backward_cpu(inputs, grads, &spec, needs);
            let all = ProjectShadeNeeds { sh: true, matte: false, ..needs };
            let expected = project_shade_backward_cpu(flat, grads, &spec, all);
            let (first, last) = expected.sh.split_at(parted.sh.len());
            assert!(found.sh == if sh { first } else { &[] }, "choice {choice}");
            assert!(found.matte == if matte { constant_of(last) } else { Vec::new() }, "choice {choice}");
            assert!(!matte || found.matte.iter().any(|gradient| *gradient != 0.0));
            let (found, expected) = (found.geometry, expected.geometry);
            assert!(found.means == expected.means && found.rotations == expected.rotations, "choice {choice}");
            assert!(found.opacities == expected.opacities && found.mean2d == expected.mean2d, "choice {choice}");
        }
    }
}
