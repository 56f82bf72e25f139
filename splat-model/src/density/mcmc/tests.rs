use burn::tensor::{Device, TensorData};
use glam::{DAffine3, DQuat, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use splat_op::{Camera, Extras, Intrinsics, RenderOptions, render_view};

use super::*;
use crate::gaussians::testing::random_rows;
use crate::gaussians::{self, sigmoid, values_of};
use crate::optim::Moments;

const STEPS: usize = 1200;
const EXTENT: f64 = 2.0;

/// Options without noise.
fn still() -> McmcConfig {
    McmcConfig { noise: 0.0, ..McmcConfig::default() }
}

fn at(step: usize) -> StrategyContext<'static> {
    StrategyContext { step, steps: STEPS, extent: EXTENT, means_rate: 1e-4, verdict: None }
}

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(5)
}

fn trained(rows: &GaussianRows) -> Trained {
    Trained::new(Gaussians::from_rows(rows, &Device::flex().autodiff()).unwrap())
}

fn logit(opacity: f64) -> f32 {
    gaussians::logit(opacity) as f32
}

/// Gaussians of these opacities, at positions whose order a refinement keeps.
fn of_opacities(opacities: &[f64]) -> GaussianRows {
    let mut rows = random_rows(opacities.len(), 1, 3);
    rows.means = (0..rows.len()).map(|i| [i as f32; 3]).collect();
    rows.logit_opacities = opacities.iter().map(|opacity| logit(*opacity)).collect();
    rows
}

fn refine(config: McmcConfig, rows: &GaussianRows, step: usize) -> (Option<RefineReport>, GaussianRows) {
    let (mut policy, mut scene) = (Mcmc::new(config, EXTENT, STEPS), trained(rows));
    let report = policy.act(&mut scene, &at(step), &mut rng()).unwrap();
    (report, scene.gaussians.to_rows())
}

/// Row `i` as a separate scene.
fn row(rows: &GaussianRows, i: usize) -> GaussianRows {
    let mut one = GaussianRows { sh_degree: rows.sh_degree, ..GaussianRows::default() };
    one.push(rows, i);
    one
}

/// Asserts that a row is row `i` of others as one of `count` Gaussians that share its opacity and size.
#[track_caller]
fn assert_shared(found: &GaussianRows, rows: &GaussianRows, i: usize, count: usize) {
    let mut expected = row(rows, i);
    let values = |value: f64| Tensor::<1>::from_floats([value as f32], &Device::flex());
    let (each, factor) = share(values(sigmoid(expected.logit_opacities[0])), values(count as f64));
    let factor: f32 = factor.into_scalar();
    expected.logit_opacities[0] = logit(each.into_scalar::<f32>().into());
    expected.log_scales[0] = expected.log_scales[0].map(|log| log + factor.ln());
    let pairs = found.log_scales[0].iter().chain(&found.logit_opacities);
    for (found, expected) in pairs.zip(expected.log_scales[0].iter().chain(&expected.logit_opacities)) {
        assert!((found - expected).abs() < 1e-5, "{found} instead of {expected}");
    }
    let (log_scales, logit_opacities) = (found.log_scales.clone(), found.logit_opacities.clone());
    assert_eq!(found, &GaussianRows { log_scales, logit_opacities, ..expected });
}

#[test]
fn the_dead_are_moved_to_the_living() {
    let mut rows = of_opacities(&[0.003, 0.5, 0.005, 1e-9, 0.2]);
    rows.rotations[4] = [f32::NAN; 4];
    let (report, after) = refine(McmcConfig { growth: 1.0, ..still() }, &rows, 500);
    // One Gaussian lives and becomes five.
    assert_eq!(report, Some(RefineReport { cloned: 4, pruned: 4, ..RefineReport::default() }));
    assert_eq!(after.len(), 5);
    for i in 0..5 {
        assert_shared(&row(&after, i), &rows, 1, 5);
    }
}

#[test]
fn those_who_are_not_drawn_stay_as_they_are_with_their_history() {
    let rows = of_opacities(&[0.9, 0.006, 0.001, 0.006, 0.006]);
    let (mut policy, mut scene) = (Mcmc::new(McmcConfig { growth: 1.0, ..still() }, EXTENT, STEPS), trained(&rows));
    let ones = Tensor::from_data(TensorData::new(vec![1.0_f32; 15], [5, 3]), &Device::flex());
    scene.moments[0][0] = Moments::full(ones.clone(), ones.zeros_like());
    policy.act(&mut scene, &at(500), &mut rng()).unwrap();
    let after = scene.gaussians.to_rows();
    // The most opaque Gaussian is drawn (50 to 1) and shares with the one that was dead.
    for (now, was) in [(0, 1), (1, 3), (2, 4)] {
        assert_eq!(row(&after, now), row(&rows, was));
    }
    [3, 4].iter().for_each(|&i| assert_shared(&row(&after, i), &rows, 0, 2));
    let [history, _] = scene.moments[0][0].numbers();
    assert_eq!(history, [[1.0; 9].as_slice(), &[0.0; 6]].concat());
}

#[test]
fn the_number_grows_to_the_cap() {
    let rows = of_opacities(&[0.5; 100]);
    for (max_splats, expected) in [(1000, 105), (103, 103), (100, 100), (20, 100)] {
        let (report, after) = refine(McmcConfig { max_splats, ..still() }, &rows, 500);
        assert_eq!((after.len(), report.unwrap().cloned), (expected, expected - 100), "cap {max_splats}");
    }
    // Above the cap the dead are removed instead of moved.
    let half_dead: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 0.5 } else { 0.001 }).collect();
    let (report, after) = refine(McmcConfig { max_splats: 70, ..still() }, &of_opacities(&half_dead), 500);
    assert_eq!((after.len(), report.unwrap().pruned, report.unwrap().cloned), (70, 50, 20));
}

#[test]
fn they_are_drawn_by_their_opacity() {
    let mut opacities = vec![0.002; 4000];
    (opacities[0], opacities[1]) = (0.6, 0.2);
    let (_, after) = refine(McmcConfig { growth: 1.0, ..still() }, &of_opacities(&opacities), 500);
    let first = after.means.iter().filter(|mean| mean[0] == 0.0).count() as f64;
    // Three quarters of 3,998 draws are expected, within five standard errors.
    assert!((first - 0.75 * 3998.0).abs() < 5.0 * (3998.0_f64 * 0.75 * 0.25).sqrt() + 1.0, "{first}");
}

#[test]
fn a_scene_of_the_dead_is_left_alone() {
    let rows = of_opacities(&[0.001; 4]);
    assert_eq!(refine(still(), &rows, 500), (None, rows));
    let none = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
    assert_eq!(refine(McmcConfig::default(), &none, 500), (None, none));
}

#[test]
fn there_is_a_time_for_it() {
    let rows = of_opacities(&[0.5, 0.001]);
    for (step, due) in [(499, false), (500, true), (501, false), (900, true), (1000, false), (1100, false)] {
        assert_eq!(refine(still(), &rows, step).0.is_some(), due, "step {step}");
        assert_eq!(Mcmc::new(still(), EXTENT, STEPS).acts_at(step), due, "step {step}");
    }
}

/// The rendered opacity, `[H, W]`.
fn seen(rows: &GaussianRows) -> Vec<f32> {
    let device = Device::flex();
    let camera = Camera::new(Intrinsics::centred(65, 65, 60.0), &DAffine3::IDENTITY, &device);
    let splats = Gaussians::from_rows(rows, &device).unwrap().splats();
    let picture = render_view(&splats, &camera, &Extras::default(), &RenderOptions::exact()).unwrap();
    values_of(picture.alpha)
}

/// The centre of the picture and a line through it stay the same, which equation 9 guarantees. Off the line the sum
/// differs, but far less than for copies that share nothing.
#[test]
fn a_relocation_hardly_shows() {
    for (opacity, dead) in [(0.3, 1), (0.6, 2), (0.9, 4)] {
        let mut rows = of_opacities(&vec![0.001; dead + 1]);
        rows.means = vec![[0.0, 0.0, 3.0]; dead + 1];
        // The dead Gaussians are out of view.
        rows.means[1..].fill([0.0, 0.0, -9.0]);
        rows.logit_opacities[0] = logit(opacity);
        rows.log_scales = vec![[0.25_f32.ln(); 3]; dead + 1];
        let (_, after) = refine(McmcConfig { growth: 1.0, ..still() }, &rows, 500);
        assert_eq!((after.len(), after.means[dead]), (dead + 1, [0.0, 0.0, 3.0]));
        let copies = GaussianRows { means: vec![rows.means[0]; dead + 1], ..after.clone() };
        let copies = GaussianRows {
            logit_opacities: vec![rows.logit_opacities[0]; dead + 1],
            log_scales: rows.log_scales.clone(),
            ..copies
        };
        let [before, after, copied] = [&rows, &after, &copies].map(seen);
        let centre = 32 * 65 + 32;
        assert!((before[centre] - after[centre]).abs() < 1e-3, "{} became {}", before[centre], after[centre]);
        let line = |picture: &[f32]| picture[32 * 65..33 * 65].iter().sum::<f32>();
        let change = |of: fn(&[f32]) -> f32, picture: &[f32]| (of(picture) / of(&before) - 1.0).abs();
        assert!((line(&after) / line(&before) - 1.0).abs() < 5e-3, "{} became {}", line(&before), line(&after));
        let all = |picture: &[f32]| picture.iter().sum::<f32>();
        let (shared, not_shared) = (change(all, &after), change(all, &copied));
        assert!(shared < 0.25 * not_shared, "opacity {opacity}: {shared} and {not_shared}");
    }
}

/// Checks the covariance of the displacement for a rotated Gaussian. The length of quaternions does not matter.
#[test]
fn noise_has_the_shape_of_the_covariance() {
    let count = 4000;
    let scales = [0.5_f64, 0.1, 0.02];
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.8);
    let mut rows = random_rows(count, 0, 2);
    rows.log_scales = vec![scales.map(|scale| scale.ln() as f32); count];
    let quaternion = [turn.w, turn.x, turn.y, turn.z];
    rows.rotations = (0..count).map(|i| quaternion.map(|q| q as f32 * [1.0, 3.0, 1e-25, 1e25][i % 4])).collect();
    rows.logit_opacities = vec![logit(0.005); count];
    let config = McmcConfig { noise: 1e3, ..McmcConfig::default() };
    let (mut policy, mut scene) = (Mcmc::new(config, EXTENT, STEPS), trained(&rows));
    policy.act(&mut scene, &at(1), &mut rng()).unwrap();
    let after = scene.gaussians.to_rows();
    assert_eq!(GaussianRows { means: rows.means.clone(), ..after.clone() }, rows);
    let moved = |i: usize| DVec3::from_array(std::array::from_fn(|a| f64::from(after.means[i][a] - rows.means[i][a])));
    for (axis, scale) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().zip(scales) {
        // λ s² σ(0), where λ is the noise times the learning rate in units of the extent.
        let expected = 1e3 * 1e-4 / (EXTENT * EXTENT) * scale * scale * 0.5;
        let along = (0..count).map(|i| moved(i).dot(turn * axis).powi(2)).sum::<f64>() / count as f64;
        // Centres are rounded to about 1e-7.
        assert!(
            (along.sqrt() / expected - 1.0).abs() < 0.06 + 3e-7 / expected,
            "{} instead of {expected}",
            along.sqrt()
        );
    }
}

#[test]
fn those_that_show_do_not_wander_and_none_wanders_without_bound() {
    let mut rows = of_opacities(&[0.3, 0.005, 0.005, 0.005]);
    rows.log_scales = vec![[-2.0; 3], [-2.0; 3], [40.0; 3], [-2.0; 3]];
    rows.rotations[3] = [0.0; 4];
    let (report, after) = refine(McmcConfig::default(), &rows, 7);
    assert_eq!(report, None);
    let moved = |i: usize| (0..3).map(|a| f64::from(after.means[i][a] - rows.means[i][a]).abs()).fold(0.0, f64::max);
    assert!(moved(0) < 1e-9, "{}", moved(0));
    assert!(moved(1) > 1e-2 && moved(1) < 10.0, "{}", moved(1));
    // The same displacement as for a Gaussian of the scene's size.
    assert!(moved(2) > 1.0 && moved(2) < 5.0 * 5e5 * 1e-4, "{}", moved(2));
}

#[test]
fn a_step_that_is_held_back_moves_nobody() {
    let rows = of_opacities(&[0.005, 0.005]);
    for (entered, moves) in [(0, true), (3, false)] {
        let verdict = Tensor::from_data(TensorData::new(vec![entered, 0], [2]), &Device::flex());
        let (mut policy, mut scene) = (Mcmc::new(McmcConfig::default(), EXTENT, STEPS), trained(&rows));
        policy.act(&mut scene, &StrategyContext { verdict: Some(&verdict), ..at(3) }, &mut rng()).unwrap();
        assert_eq!(scene.gaussians.to_rows() != rows, moves);
    }
}

#[test]
fn penalties_are_those_of_the_paper_in_units_of_the_extent() {
    let rows = random_rows(20, 0, 4);
    let gaussians = trained(&rows).gaussians;
    let penalty = Mcmc::new(McmcConfig::default(), EXTENT, STEPS).penalty(&gaussians.splats(), 1).unwrap();
    let opacities = rows.logit_opacities.iter().map(|logit| 1.0 / (1.0 + (-f64::from(*logit)).exp()));
    let scales = rows.log_scales.as_flattened().iter().map(|log| f64::from(*log).exp() / EXTENT);
    let expected = 0.01 * opacities.sum::<f64>() / 20.0 + 0.01 * scales.sum::<f64>() / 60.0;
    let found: f64 = penalty.clone().inner().into_scalar();
    assert!((found / expected - 1.0).abs() < 1e-5, "{found} instead of {expected}");
    let mut gradients = penalty.backward();
    assert!(gaussians.log_scales().grad_remove(&mut gradients).is_some());
    assert!(gaussians.gradient("logit_opacities", &gradients).is_some());
}

#[test]
fn gaussians_start_small_and_half_opaque() {
    let mut rows = random_rows(3, 0, 4);
    let before = rows.clone();
    Mcmc::new(McmcConfig::default(), EXTENT, STEPS).start(&mut rows);
    assert_eq!(rows.logit_opacities, [0.0; 3]);
    for (now, was) in rows.log_scales.as_flattened().iter().zip(before.log_scales.as_flattened()) {
        assert!((now.exp() / was.exp() - 0.1).abs() < 1e-6);
    }
    assert_eq!(rows.means, before.means);
}

#[test]
fn a_run_goes_on_as_it_would_have() {
    let rows = of_opacities(&[0.005, 0.01, 0.5, 0.02]);
    let (mut policy, mut scene, mut rng) = (Mcmc::new(McmcConfig::default(), EXTENT, STEPS), trained(&rows), rng());
    policy.act(&mut scene, &at(1), &mut rng).unwrap();
    let mut state = State::default();
    policy.save(&mut state).unwrap();
    let (mut again, mut same_scene, mut same_rng) =
        (Mcmc::new(McmcConfig::default(), EXTENT, STEPS), scene.clone(), rng.clone());
    again.load(&mut state, &Device::flex()).unwrap();
    state.finish().unwrap();
    for step in [2, 500, 501] {
        policy.act(&mut scene, &at(step), &mut rng).unwrap();
        again.act(&mut same_scene, &at(step), &mut same_rng).unwrap();
        assert_eq!(scene.gaussians.to_rows(), same_scene.gaussians.to_rows(), "step {step}");
    }
}
