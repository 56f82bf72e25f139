//! Density control on every device: each strategy chooses the same rows, and reads back counts only. A process of its own, because the
//! counter of bytes is global.

use std::sync::Mutex;
use std::time::Instant;

use burn::tensor::{Device, Tensor, TensorData};
use glam::DAffine3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_model::cleanup::Contribution;
use splat_model::density::rows::{RowEdit, Trained};
use splat_model::density::{AdaptiveConfig, DensityConfig, McmcConfig, Observed, StrategyContext, rows_on};
use splat_model::effects::background::Backdrop;
use splat_model::effects::depth::{DepthConfig, DepthSample};
use splat_model::effects::exposure::ExposureConfig;
use splat_model::effects::grid::GridConfig;
use splat_model::effects::optics::OpticsConfig;
use splat_model::effects::pose::PoseConfig;
use splat_model::gaussians::{GaussianRows, Gaussians, Group, GroupOptions, NewRows, values_of};
use splat_model::optim::MomentBits;
use splat_model::trainer::TrainConfig;
use splat_op::test_hooks::read_bytes;
use splat_op::{Intrinsics, RenderOptions};
use splat_tests::places;
use splat_tests::slope::slope_trainer_with;

const EXTENT: f64 = 2.0;
const STEP: usize = 600;
const STEPS: usize = 30_000;

/// Bytes that a refinement may read back at any number of Gaussians: a few counts.
const BYTES: u64 = 256;

static ALONE: Mutex<()> = Mutex::new(());

/// Gaussians of many sizes and opacities, some of them faint, some unusable.
fn rows(count: usize) -> GaussianRows {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut rows = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
    for i in 0..count {
        let mut draw = |from: f32, to: f32| rng.random_range(from..to);
        rows.means.push(std::array::from_fn(|_| draw(-3.0, 5.0)));
        rows.rotations.push(std::array::from_fn(|_| draw(-1.0, 1.0)));
        rows.log_scales.push(std::array::from_fn(|_| draw(-6.0, -2.0)));
        rows.logit_opacities.push(if i % 97 == 3 { f32::NAN } else { draw(-7.0, 4.0) });
        rows.sh_dc.push(std::array::from_fn(|_| draw(-1.5, 1.5)));
        (0..9).for_each(|_| rows.sh_rest.push(draw(-0.2, 0.2)));
    }
    rows
}

fn strategies(count: usize) -> [(&'static str, DensityConfig); 5] {
    let most = count + count / 20;
    [
        ("adaptive", AdaptiveConfig { max_splats: 2 * count, ..AdaptiveConfig::default() }.into()),
        ("adaptive at its cap", AdaptiveConfig { max_splats: most, ..AdaptiveConfig::default() }.into()),
        ("absgrad", AdaptiveConfig { max_splats: 2 * count, ..AdaptiveConfig::absgrad() }.into()),
        ("gradual", AdaptiveConfig { max_splats: most, ..AdaptiveConfig::gradual() }.into()),
        ("mcmc", McmcConfig { max_splats: most, noise: 0.0, ..McmcConfig::default() }.into()),
    ]
}

/// The scene after one refinement, its report in words, the bytes read back and the seconds.
fn refined(density: DensityConfig, from: &GaussianRows, device: &Device) -> (GaussianRows, String, u64, f64) {
    let mut scene = Trained::new(Gaussians::from_rows(from, &device.clone().autodiff()).expect("rows of one length"));
    let mut strategy = density.strategy(EXTENT, STEPS);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let gradients: Vec<f32> = (0..2 * from.len()).map(|_| 1e-3 * rng.random::<f32>().powi(2)).collect();
    let gradients = Tensor::<2>::from_data(TensorData::new(gradients, [from.len(), 2]), device);
    let size = (2, 2);
    let [gradient, abs_gradient] = match strategy.listens_at(STEP).abs_gradient {
        true => [None, Some(gradients)],
        false => [Some(gradients), None],
    };
    strategy.observe(Observed { gradient, abs_gradient, size });
    let at = StrategyContext { step: STEP, steps: STEPS, extent: EXTENT, means_rate: 1e-4, verdict: None };
    device.sync().expect("the device is there");
    let (before, start) = (read_bytes(), Instant::now());
    let report = strategy.act(&mut scene, &at, &mut rng).expect("rows of one length").expect("a refinement is due");
    device.sync().expect("the device is there");
    let (bytes, seconds) = (read_bytes() - before, start.elapsed().as_secs_f64());
    (scene.gaussians.to_rows(), format!("{report:.4?}"), bytes, seconds)
}

/// The largest difference of two scenes' numbers.
fn difference(a: &GaussianRows, b: &GaussianRows) -> f32 {
    let numbers = |rows: &GaussianRows| -> Vec<f32> {
        let triples = rows.means.iter().chain(&rows.log_scales).chain(&rows.sh_dc).flatten();
        let others = rows.rotations.iter().flatten().chain(&rows.logit_opacities).chain(&rows.sh_rest);
        triples.chain(others).copied().collect()
    };
    numbers(a).iter().zip(numbers(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn every_strategy_chooses_the_same_rows_on_every_device() {
    let _alone = ALONE.lock();
    let from = rows(5_000);
    for (name, density) in strategies(from.len()) {
        let (expected, report, ..) = refined(density, &from, &Device::flex());
        assert!(expected.len() != from.len() && expected.len() % 8 == 0, "{name}: {}", expected.len());
        assert_eq!(expected.unusable(), 0, "{name}");
        for place in places() {
            let (found, its_report, ..) = refined(density, &from, &place.device);
            assert_eq!((found.len(), its_report), (expected.len(), report.clone()), "{name} on {}", place.name);
            // Rows in another order differ by the size of the scene.
            let difference = difference(&found, &expected);
            assert!(difference < 1e-3, "{name} on {}: a difference of {difference}", place.name);
        }
    }
}

/// Edits that add no row, keep no row or leave none: buffers and launches then have no size.
#[test]
fn edits_without_rows_work_on_every_device() {
    let _alone = ALONE.lock();
    let options = GroupOptions { new_rows: NewRows::Filled(-1.0), reset: Some(0.25), ..GroupOptions::default() };
    for (place, bits) in places().iter().flat_map(|place| MomentBits::ALL.map(|bits| (place, bits))) {
        let from = rows(3);
        let device = place.device.clone().autodiff();
        let values = Tensor::from_floats([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], &device);
        let group = Group::new("features", values, options).expect("the options are in range");
        let gaussians = Gaussians::from_rows(&from, &device).expect("rows of one length");
        let mut scene = Trained::with_bits(gaussians, bits).with_group(group).expect("as many rows");
        let edit = |scene: &mut Trained, keep: &[u32], copied: &[u32]| {
            let [keep, copied] = [keep, copied].map(|rows| rows_on(&place.device, rows));
            scene.edit(&RowEdit::new(keep, copied)).expect("no change is named");
        };
        let found = |scene: &Trained| {
            let group = scene.gaussians.group("features").expect("it was added");
            (scene.gaussians.to_rows().means, values_of(group.raw()))
        };
        let at = format!("{} with moments of {} bits", place.name, u8::from(bits));
        edit(&mut scene, &[2, 0], &[]);
        assert_eq!(found(&scene), (vec![from.means[2], from.means[0]], vec![5.0, 6.0, 1.0, 2.0]), "{at}: no new row");
        edit(&mut scene, &[], &[1]);
        assert_eq!(found(&scene), (vec![from.means[0]], vec![-1.0, -1.0]), "{at}: a new row alone");
        scene.reset_opacities(Tensor::from_floats([0.5], &place.device));
        assert_eq!(found(&scene).1, [0.25, 0.25], "{at}: a reset");
        for _ in 0..2 {
            edit(&mut scene, &[], &[]);
            scene.reset_opacities(rows_on(&place.device, &[]).float());
            assert_eq!(found(&scene), (Vec::new(), Vec::new()), "{at}: no row is left");
        }
    }
}

#[test]
fn a_scene_of_no_gaussians_has_contributions_on_every_device() {
    let _alone = ALONE.lock();
    for place in places() {
        let camera = [(Intrinsics::centred(40, 30, 40.0), DAffine3::IDENTITY)];
        let found = Contribution::of(&rows(0), camera, &RenderOptions::standard(), &place.device, || ());
        assert_eq!(found, Ok(Contribution::default()), "{}", place.name);
    }
}

#[test]
fn a_refinement_reads_back_counts_only() {
    let _alone = ALONE.lock();
    for (name, place) in
        places().into_iter().flat_map(|place| strategies(1).map(|(name, _)| (name, place.device.clone())))
    {
        for count in [3_000, 24_000] {
            let density = strategies(count).into_iter().find(|(other, _)| *other == name).expect("of the same list").1;
            let (.., bytes, seconds) = refined(density, &rows(count), &place);
            println!("{name}, {count} Gaussians, {place:?}: {bytes} bytes, {seconds:.3} s");
            assert!((1..=BYTES).contains(&bytes), "{name}: {bytes} bytes read back at {count} Gaussians on {place:?}");
        }
    }
}

/// Runs without effects, with each that `splat train` may choose by itself, and with all that go together.
fn effects() -> Vec<(&'static str, TrainConfig)> {
    let plain = TrainConfig::default();
    let optics = |motion, rolling| OpticsConfig { motion, rolling };
    let (exposure, grid, poses) = (ExposureConfig::default(), GridConfig::default(), PoseConfig::default());
    let (depth, backdrop) = (Some(DepthConfig::default()), Backdrop::Environment { degree: 2 });
    let (exposure, grid, poses) = (Some(exposure), Some(grid), Some(poses));
    vec![
        ("nothing", plain.clone()),
        ("antialias", TrainConfig { smoothing: true, antialias: true, ..plain.clone() }),
        ("alpha", TrainConfig { backdrop: Backdrop::Random, ..plain.clone() }),
        ("exposure", TrainConfig { exposure, ..plain.clone() }),
        ("grid", TrainConfig { grid, ..plain.clone() }),
        ("poses", TrainConfig { poses, ..plain.clone() }),
        ("environment", TrainConfig { backdrop, ..plain.clone() }),
        ("motion", TrainConfig { optics: optics(true, false), ..plain.clone() }),
        ("rolling shutter", TrainConfig { optics: optics(false, true), ..plain.clone() }),
        ("depth", TrainConfig { depth, ..plain.clone() }),
        (
            "all",
            TrainConfig {
                smoothing: true,
                antialias: true,
                exposure,
                grid,
                poses,
                backdrop,
                optics: optics(true, true),
                depth,
                ..plain
            },
        ),
    ]
}

/// Steps in between read the counts of `intersect` and the guard's verdict. (The counts are two numbers for each of at most 1,024 cubes.)
/// The hundred steps include one in which the 3D filter follows the scene. A driver in software is slow, and takes three of the runs.
#[test]
fn a_step_reads_back_a_few_numbers() {
    let _alone = ALONE.lock();
    let known = [([0.5, 0.5], 2.0), ([0.3, 0.4], 2.5)].map(|(at, depth)| DepthSample { at, depth });
    for (place, (name, config)) in
        places().into_iter().flat_map(|place| effects().into_iter().map(move |effect| (place.clone(), effect)))
    {
        // The others take minutes there.
        if place.software && !["nothing", "antialias", "exposure"].contains(&name) {
            continue;
        }
        let mut run = slope_trainer_with(config, &place.device).with_depths(vec![known.to_vec()]);
        run.step().expect("a sound run");
        let before = read_bytes();
        (0..100).for_each(|_| drop(run.step().expect("a sound run")));
        place.device.sync().expect("the device is there");
        let bytes = (read_bytes() - before) as f64 / 100.0;
        println!("{name} on {}: {bytes} bytes a step", place.name);
        assert!(bytes > 0.0 && bytes <= 64.0, "{name} on {}: {bytes} bytes read back a step", place.name);
    }
}

/// Seconds of a refinement, to compare revisions: `SPLAT_ROWS=1000000 cargo test --release -p splat-tests --test density seconds -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn seconds_of_a_refinement() {
    let _alone = ALONE.lock();
    let count = std::env::var("SPLAT_ROWS").map_or(300_000, |rows| rows.parse().expect("a number of rows"));
    let from = rows(count);
    for (name, density) in strategies(count) {
        for place in places().into_iter().filter(|place| place.name != "ndarray") {
            let best = (0..3).map(|_| refined(density, &from, &place.device).3).fold(f64::INFINITY, f64::min);
            println!("{name} on {}: {best:.3} s for {count} Gaussians", place.name);
        }
    }
}
