use burn::tensor::{Device, TensorData};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::capture::blocks::Bounds;
use crate::density::Focus;
use crate::gaussians::testing::random_rows;
use crate::gaussians::{GaussianRows, values_of};

const STEPS: usize = 30_000;
const EXTENT: f64 = 2.0;
/// A picture of 2 × 2 px: gradients per px equal gradients per unit of normalised device coordinates.
const UNIT: (usize, usize) = (2, 2);
/// Sizes below and above the threshold for splitting, and above the threshold for removal, in shares of the extent.
const SMALL: f32 = 0.019;
const LARGE: f32 = 0.021;
const HUGE: f32 = 0.21;

fn adaptive(config: AdaptiveConfig) -> Adaptive {
    Adaptive::new(config, EXTENT, STEPS)
}

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(5)
}

fn trained(rows: &GaussianRows) -> Trained {
    Trained::new(Gaussians::from_rows(rows, &Device::flex().autodiff()).unwrap())
}

/// Gradients at the projected centres, in a picture of the given size, px.
fn seen(gradients: &[[f32; 2]], size: (usize, usize)) -> Observed {
    let values = TensorData::new(gradients.as_flattened().to_vec(), [gradients.len(), 2]);
    Observed { gradient: Some(Tensor::from_data(values, &Device::flex())), size, ..Observed::default() }
}

fn at(step: usize) -> StrategyContext<'static> {
    StrategyContext { step, steps: STEPS, extent: EXTENT, means_rate: 0.0, verdict: None }
}

/// Positions whose order a refinement keeps.
fn in_order(count: usize) -> Vec<[f32; 3]> {
    (0..count).map(|i| [i as f32; 3]).collect()
}

/// Round Gaussians of these sizes and opacities.
fn round(sizes_and_opacities: &[(f32, f32)]) -> GaussianRows {
    let mut rows = random_rows(sizes_and_opacities.len(), 1, 1);
    rows.means = in_order(rows.len());
    rows.log_scales = sizes_and_opacities.iter().map(|(size, _)| [size.ln(); 3]).collect();
    rows.logit_opacities = sizes_and_opacities.iter().map(|(_, opacity)| (opacity / (1.0 - opacity)).ln()).collect();
    rows
}

/// Refines once after one view with these gradients.
fn refine(
    config: AdaptiveConfig,
    rows: &GaussianRows,
    lengths: &[f32],
    step: usize,
) -> (Option<RefineReport>, GaussianRows) {
    let (mut policy, mut scene) = (adaptive(config), trained(rows));
    policy.observe(seen(&lengths.iter().map(|length| [0.0, *length]).collect::<Vec<_>>(), UNIT));
    let report = policy.act(&mut scene, &at(step), &mut rng()).unwrap();
    (report, scene.gaussians.to_rows())
}

/// The mean gradients of so many rows.
fn mean_gradients(policy: &mut Adaptive, count: usize) -> Vec<f32> {
    values_of(policy.mean_gradients(&trained(&random_rows(count, 0, 1)).gaussians.untracked()))
}

/// Row `i` as a separate scene.
fn row(rows: &GaussianRows, i: usize) -> GaussianRows {
    let mut one = GaussianRows { sh_degree: rows.sh_degree, ..GaussianRows::default() };
    one.push(rows, i);
    one
}

#[test]
fn small_are_cloned_large_are_split_and_faint_are_removed() {
    let rows = round(&[(SMALL, 0.5), (LARGE, 0.5), (SMALL, 0.5), (SMALL, 0.004), (LARGE, 0.006), (HUGE, 0.5)]);
    let lengths = [3e-4, 3e-4, 1.9e-4, 1.0, 1e-4, 0.0];
    let (report, after) = refine(AdaptiveConfig::default(), &rows, &lengths, 500);
    assert_eq!(report, Some(RefineReport { cloned: 1, split: 1, pruned: 1, threshold: 2e-4 }));
    // The rows that stay, then the copy, then the two parts.
    for (now, was) in [(0, 0), (1, 2), (2, 4), (3, 5), (4, 0)] {
        assert_eq!(row(&after, now), row(&rows, was), "row {now}");
    }
    assert_eq!(after.len(), 7);
    for part in [5, 6] {
        let mut expected = row(&rows, 1);
        assert_ne!(after.means[part], expected.means[0]);
        expected.means[0] = after.means[part];
        expected.log_scales[0] = expected.log_scales[0].map(|log| log - 1.6f64.ln() as f32);
        assert_eq!(row(&after, part), expected);
    }
    assert_ne!(after.means[5], after.means[6]);
}

#[test]
fn those_that_stay_come_in_morton_order() {
    let rows = GaussianRows { means: vec![[0.0; 3], [9.0; 3], [1.0; 3], [8.0; 3]], ..round(&[(SMALL, 0.5); 4]) };
    let (_, after) = refine(AdaptiveConfig::default(), &rows, &[0.0; 4], 500);
    for (now, was) in [0, 2, 3, 1].into_iter().enumerate() {
        assert_eq!(row(&after, now), row(&rows, was), "row {now}");
    }
}

#[test]
fn huge_gaussians_go_after_the_first_opacity_reset() {
    let rows = round(&[(SMALL, 0.5), (HUGE, 0.5)]);
    for (step, left) in [(2_900, 2), (3_000, 2), (3_100, 1), (6_000, 1)] {
        assert_eq!(refine(AdaptiveConfig::default(), &rows, &[0.0; 2], step).1.len(), left, "step {step}");
    }
    let never = AdaptiveConfig { reset_every: 0, ..AdaptiveConfig::default() };
    assert_eq!(refine(never, &rows, &[0.0; 2], 3_100).1.len(), 2);
}

#[test]
fn whatever_is_not_finite_is_removed() {
    type Spoil = fn(&mut GaussianRows);
    let spoils: [Spoil; 10] = [
        |rows| rows.means[1][2] = f32::INFINITY,
        |rows| rows.rotations[1][0] = f32::NAN,
        |rows| rows.log_scales[1] = [f32::NAN; 3],
        |rows| rows.log_scales[1][1] = f32::NAN,
        |rows| rows.log_scales[1][0] = f32::INFINITY,
        |rows| rows.log_scales[1][0] = f32::NEG_INFINITY,
        |rows| rows.logit_opacities[1] = f32::NAN,
        |rows| rows.logit_opacities[1] = f32::INFINITY,
        |rows| rows.sh_dc[1][1] = f32::NAN,
        |rows| rows.sh_rest[9 + 4] = f32::NAN,
    ];
    for (case, spoil) in spoils.into_iter().enumerate() {
        let rows = round(&[(SMALL, 0.5), (SMALL, 0.5), (SMALL, 0.5)]);
        let mut spoiled = rows.clone();
        spoil(&mut spoiled);
        let (report, after) = refine(AdaptiveConfig::default(), &spoiled, &[0.0, f32::NAN, 0.0], 500);
        assert_eq!(report.unwrap().pruned, 1, "case {case}");
        assert_eq!([row(&after, 0), row(&after, 1)], [row(&rows, 0), row(&rows, 2)], "case {case}");
    }
}

#[test]
fn at_the_cap_the_largest_gradients_win() {
    let mut sizes = vec![(SMALL, 0.5); 8];
    (sizes[1], sizes[3]) = ((LARGE, 0.5), (SMALL, 0.001));
    let rows = round(&sizes);
    // Row 3 is removed, so there is room for three. Rows 0 and 7 are below the threshold.
    let lengths = [1e-4, 9e-4, 4e-4, 1.0, 3e-4, 7e-4, 8e-4, 0.0];
    let config = AdaptiveConfig { max_splats: 10, ..AdaptiveConfig::default() };
    let (report, after) = refine(config, &rows, &lengths, 500);
    let report = report.unwrap();
    assert_eq!((report.cloned, report.split, report.pruned, after.len()), (2, 1, 1, 10));
    assert!((report.threshold - 4e-4).abs() < 1e-9, "{}", report.threshold);
    let copies: Vec<_> = after.means.iter().filter(|mean| [5, 6].map(|i| rows.means[i]).contains(mean)).collect();
    assert_eq!(copies.len(), 4);
    for max_splats in 0..=12 {
        let (report, after) = refine(AdaptiveConfig { max_splats, ..config }, &rows, &lengths, 500);
        // Seven survive. The cap ends growth and removes nothing.
        assert_eq!(after.len(), max_splats.clamp(7, 12), "cap {max_splats}");
        let threshold = report.unwrap().threshold;
        assert_eq!(threshold > 2.1e-4, max_splats < 12, "cap {max_splats}: {threshold}");
    }
}

#[test]
fn there_is_a_time_for_it() {
    let rows = round(&[(SMALL, 0.5), (HUGE, 0.004)]);
    let config = AdaptiveConfig { reset_every: 1, ..AdaptiveConfig::default() };
    let counts = [(499, None), (501, None), (500, Some(1)), (14_900, Some(1)), (15_000, None), (20_000, None)];
    for (step, pruned) in counts {
        let (report, after) = refine(config, &rows, &[1.0; 2], step);
        assert_eq!(report.map(|report| report.pruned), pruned, "step {step}");
        // Opacity resets have their own schedule, which ends with density control.
        assert_eq!(after.logit_opacities[0] < 0.0, step < 15_000, "step {step}");
        assert_eq!(adaptive(config).listens_at(step).gradient, step < 15_000, "step {step}");
        if step >= 15_000 {
            assert_eq!(after, rows);
        }
    }
    let growing = AdaptiveConfig { from: 0, every: 7, until_share: 1.0, reset_every: 0, ..config };
    let due: Vec<usize> = (1..22).filter(|&step| refine(growing, &rows, &[0.0; 2], step).0.is_some()).collect();
    assert_eq!(due, [7, 14, 21]);
}

#[test]
fn a_reset_caps_opacities() {
    let rows = round(&[(SMALL, 0.9), (SMALL, 0.02), (SMALL, 0.007)]);
    let (mut policy, mut scene) = (adaptive(AdaptiveConfig::default()), trained(&rows));
    policy.act(&mut scene, &at(2_999), &mut rng()).unwrap();
    assert_eq!(scene.gaussians.to_rows(), rows);
    policy.act(&mut scene, &at(3_000), &mut rng()).unwrap();
    let opacities = values_of(scene.gaussians.opacities());
    for (found, expected) in opacities.iter().zip([0.01, 0.01, 0.007]) {
        assert!((found - expected).abs() < 1e-6, "{opacities:?}");
    }
}

#[test]
fn needles_are_shortened() {
    let mut rows = GaussianRows { means: in_order(4), ..random_rows(4, 0, 1) };
    // Needles along each axis, and a disc, which is not a needle.
    let scales = [[0.05, 0.001, 1e-4], [1e-4, 0.05, 0.001], [0.001, 1e-4, 0.05], [0.019, 1e-6, 0.019]];
    rows.log_scales = scales.map(|scales: [f32; 3]| scales.map(f32::ln)).to_vec();
    let (_, after) = refine(AdaptiveConfig::default(), &rows, &[0.0; 4], 500);
    for (i, axis) in [0, 1, 2].into_iter().enumerate() {
        assert!((after.log_scales[i][axis].exp() - 0.03).abs() < 1e-6, "{:?}", after.log_scales[i]);
        let mut restored = after.log_scales[i];
        restored[axis] = rows.log_scales[i][axis];
        assert_eq!(restored, rows.log_scales[i]);
    }
    assert_eq!(after.log_scales[3], rows.log_scales[3]);
}

#[test]
fn gradients_are_averaged_per_unit_of_device_coordinates() {
    let mut policy = adaptive(AdaptiveConfig::default());
    // Half of 32 × 24 px is 16 × 12: a gradient of (3, 4) per px is (48, 48) per unit, and (1, 0) is 16.
    policy.observe(seen(&[[3.0, -4.0], [1.0, 0.0], [0.0, 0.0]], (32, 24)));
    policy.observe(seen(&[[0.0, 0.0], [0.0, -1.0], [0.0, 0.0]], (32, 24)));
    // Steps in which a Gaussian was not visible do not count.
    let found = mean_gradients(&mut policy, 3);
    for (found, expected) in found.iter().zip([48.0 * 2f32.sqrt(), 14.0, 0.0]) {
        assert!((found - expected).abs() < 1e-4, "{found} instead of {expected}");
    }
}

#[test]
fn statistics_start_anew_after_a_refinement() {
    let rows = round(&[(SMALL, 0.5), (SMALL, 0.5)]);
    let (mut policy, mut scene) = (adaptive(AdaptiveConfig::default()), trained(&rows));
    policy.observe(seen(&[[1.0, 0.0], [0.0, 0.0]], UNIT));
    assert_eq!(policy.act(&mut scene, &at(500), &mut rng()).unwrap().unwrap().cloned, 1);
    assert_eq!(policy.act(&mut scene, &at(600), &mut rng()).unwrap().unwrap().cloned, 0);
    policy.observe(seen(&[[0.0; 2]; 3], UNIT));
    assert_eq!(mean_gradients(&mut policy, 3), [0.0; 3]);
}

#[test]
fn absolute_gradients_take_the_place_of_the_others() {
    let policy = adaptive(AdaptiveConfig::absgrad());
    assert_eq!(policy.listens_at(1), Signals { abs_gradient: true, ..Signals::default() });
    assert_eq!(policy.listens_at(STEPS), Signals::default());
    assert_eq!(adaptive(AdaptiveConfig::default()).listens_at(1), Signals { gradient: true, ..Signals::default() });
    let rows = round(&[(SMALL, 0.5), (SMALL, 0.5)]);
    let (mut policy, mut scene) = (policy, trained(&rows));
    let Observed { gradient, size, .. } = seen(&[[0.0, 7e-4], [0.0, 9e-4]], UNIT);
    policy.observe(Observed { abs_gradient: gradient, size, ..Observed::default() });
    let report = policy.act(&mut scene, &at(500), &mut rng()).unwrap().unwrap();
    assert_eq!((report.cloned, report.threshold), (1, 8e-4));
    assert_eq!(row(&scene.gaussians.to_rows(), 2), row(&rows, 1));
}

#[test]
fn statistics_are_taken_up_again() {
    let rows = round(&[(SMALL, 0.5), (SMALL, 0.5)]);
    let mut policy = adaptive(AdaptiveConfig::default());
    policy.observe(seen(&[[1.0, 0.0], [0.0, 1e-4]], UNIT));
    policy.observe(seen(&[[1.0, 0.0], [0.0, 0.0]], UNIT));
    let mut state = State::default();
    policy.save(&mut state).unwrap();
    let mut again = adaptive(AdaptiveConfig::default());
    again.load(&mut state, &Device::flex()).unwrap();
    state.finish().unwrap();
    assert_eq!(mean_gradients(&mut again, 2), [1.0, 1e-4]);
    // Right after a refinement there are no statistics to keep.
    let mut scene = trained(&rows);
    policy.act(&mut scene, &at(500), &mut rng()).unwrap();
    let mut state = State::default();
    policy.save(&mut state).unwrap();
    assert_eq!(state, State::default());
    again.observe(seen(&[[1.0, 0.0], [0.0, 1e-4]], UNIT));
    again.load(&mut state, &Device::flex()).unwrap();
    assert_eq!(mean_gradients(&mut again, 2), [0.0; 2]);
}

/// Of 200 rows, 200 are wanted: a tenth is taken, or all but those that may wait, within the pace that meets the cap. The last
/// refinement of a run of 30,000 steps is at 14,900.
#[test]
fn growth_takes_a_share_or_more_where_many_wait_and_meets_the_cap_at_the_last_refinement() {
    let count = 200;
    let rows = round(&vec![(SMALL, 0.5); count]);
    let lengths: Vec<f32> = (0..count).map(|i| 1.0 + i as f32).collect();
    for (waiting, max_splats, step, added) in [
        (1.0, 1_000_000, 500, 20),
        (1.0, 1_000_000, 14_900, 20),
        (1.0, 200, 500, 0),
        (1.0, 210, 14_900, 10),
        (1.0, 210, 14_800, 5),
        (1.0, 190, 500, 0),
        (0.95, 1_000_000, 500, 20),
        (0.875, 1_000_000, 500, 25),
        (0.0, 1_000_000, 500, 40),
        (0.0, 230, 14_900, 30),
        (0.0, 230, 14_800, 15),
        (0.0, 200, 500, 0),
    ] {
        let (division, growth) = (Division::LongAxis, Some(0.1));
        let config = AdaptiveConfig { division, growth, waiting, max_splats, ..AdaptiveConfig::default() };
        let (report, after) = refine(config, &rows, &lengths, step);
        let report = report.unwrap();
        assert_eq!((report.split, after.len()), (added, count + added), "{waiting}, {max_splats}, {step}");
        // Row `i` has a gradient of `i + 1`.
        assert_eq!(report.threshold, (count - added) as f64, "{waiting}, {max_splats}, {step}");
    }
}

/// Beyond the focus as many rows are added as its share of the cap has room for; within it nothing changes.
#[test]
fn growth_beyond_the_focus_ends_at_its_share() {
    let count = 100;
    let rows = round(&vec![(SMALL, 0.5); count]);
    let lengths: Vec<f32> = (0..count).map(|i| 1.0 + i as f32).collect();
    // Rows 0 to 59 lie within, rows 60 to 99, whose gradients are the largest, beyond.
    let bounds = Bounds { high: [Some(60.0), None, None], ..Bounds::everything(glam::DMat3::IDENTITY) };
    for (beyond_share, added) in [(0.0, 0), (0.2, 0), (0.25, 10), (1.0, 40)] {
        let config = AdaptiveConfig {
            max_splats: 200,
            focus: Some(Focus { bounds, beyond_share }),
            ..AdaptiveConfig::default()
        };
        let (report, after) = refine(config, &rows, &lengths, 500);
        let beyond = after.means.iter().filter(|mean| mean[0] >= 60.0).count();
        assert_eq!((report.unwrap().cloned, beyond), (60 + added, 40 + added), "{beyond_share}");
        // The largest gradients come first.
        let copies = after.means[count..].iter().filter(|mean| mean[0] >= 60.0).map(|mean| mean[0] as usize);
        assert_eq!(copies.min().unwrap_or(count), count - added, "{beyond_share}");
    }
}
