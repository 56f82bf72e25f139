use std::cell::RefCell;
use std::rc::Rc;

use glam::DAffine3;

use super::testing::{HEIGHT, WIDTH, photos, points};
use super::*;
use crate::density::{AdaptiveConfig, Division, McmcConfig};
use crate::effects::background::Backdrop;
use crate::gaussians::{GaussianRows, values_of};
use crate::init;
use crate::optim::LearningRates;

/// Learning rates for a run of a few dozen steps. The defaults are for thousands.
fn config(steps: usize) -> TrainConfig {
    let learning_rates =
        LearningRates { sh_dc: 0.05, opacities: 0.1, scales: 0.02, rotations: 0.01, ..LearningRates::default() };
    TrainConfig { steps, learning_rates, ..TrainConfig::default() }
}

/// Density control in which all events happen within a few steps.
const EVENTFUL: AdaptiveConfig = AdaptiveConfig {
    every: 5,
    from: 5,
    until_share: 0.9,
    grad_threshold: 1e-5,
    absolute: false,
    split_scale: 0.01,
    prune_opacity: 0.005,
    prune_scale: 0.1,
    reset_every: 14,
    max_splats: 60,
    division: Division::CloneOrSplit,
    growth: None,
    waiting: 1.0,
    max_elongation: 30.0,
    focus: None,
};

/// A run with all events: the degree of the harmonics rises, Gaussians are added and removed, opacities are reset.
fn eventful() -> TrainConfig {
    TrainConfig { sh_every: 6, density: EVENTFUL.into(), ..config(24) }
}

fn trainer(config: TrainConfig) -> Trainer {
    Trainer::new(photos(config.background), &points(), config, &Device::flex()).unwrap()
}

/// Trains to the end of a run. Returns losses by step, and the scene.
fn run(mut trainer: Trainer) -> (Vec<f32>, GaussianRows) {
    let mut losses = Vec::new();
    while !trainer.is_done() {
        let next = trainer.steps_done() + 1;
        let report = trainer.step().unwrap();
        assert_eq!((report.step, trainer.steps_done()), (next, next));
        assert_eq!(report.splats, trainer.gaussians().len());
        losses.push(report.loss.into_scalar::<f32>());
    }
    (losses, trainer.gaussians().to_rows())
}

#[test]
fn eight_epochs_halve_the_loss() {
    let (losses, _) = run(trainer(config(32)));
    assert_eq!(losses.len(), 32);
    let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
    let (first, last) = (mean(&losses[..4]), mean(&losses[28..]));
    assert!(last < 0.5 * first, "from {first} to {last}");
}

#[test]
fn a_seed_decides_everything() {
    let seeded = |seed| trainer(TrainConfig { seed, ..eventful() });
    let (first, second) = (run(seeded(7)), run(seeded(7)));
    assert_eq!(first, second);
    assert_ne!(first.1, run(seeded(8)).1);
    // All events of the run happened.
    assert!(first.1.len() > 30 && first.1.len() <= 60 && first.1.sh_degree == 3, "{}", first.1.len());
}

#[test]
fn random_points_come_from_the_seed_too() {
    let seeded = |seed| {
        let density = AdaptiveConfig { max_splats: 50, ..AdaptiveConfig::default() };
        let config = TrainConfig { seed, density: density.into(), ..config(2) };
        Trainer::new(photos([0.0; 3]), &PointCloud::default(), config, &Device::flex()).unwrap()
    };
    assert_eq!(seeded(1).gaussians().len(), 50);
    assert_ne!(seeded(1).gaussians().to_rows(), seeded(2).gaussians().to_rows());
    assert_eq!(run(seeded(1)), run(seeded(1)));
}

#[test]
fn every_epoch_visits_every_view_once() {
    let mut trainer = trainer(config(40));
    let visited: Vec<String> = (0..40).map(|_| trainer.step().unwrap().view).collect();
    let mut orders = std::collections::BTreeSet::new();
    for epoch in visited.chunks(4) {
        let mut sorted = epoch.to_vec();
        sorted.sort();
        assert_eq!(sorted, ["a", "b", "c", "d"]);
        orders.insert(epoch.to_vec());
    }
    assert!(orders.len() > 3, "{} orders in ten epochs", orders.len());
}

#[test]
fn a_loss_of_the_callers_is_what_is_minimised() {
    let seen_views = Rc::new(RefCell::new(Vec::new()));
    let record = seen_views.clone();
    let loss = move |seen: &LossInputs| {
        assert_eq!(seen.image.dims(), [HEIGHT, WIDTH, 3]);
        assert_eq!(seen.alpha.dims(), [HEIGHT, WIDTH, 1]);
        assert_eq!(seen.truth.image().dims(), [HEIGHT, WIDTH, 3]);
        record.borrow_mut().push((seen.step, seen.view.to_string()));
        seen.input.splats.opacities.clone().mean()
    };
    let mut trainer = trainer(config(3)).with_loss(loss);
    let before = trainer.gaussians().to_rows();
    let reports: Vec<StepReport> = (0..3).map(|_| trainer.step().unwrap()).collect();
    let losses: Vec<f32> = reports.iter().map(|report| report.loss.clone().into_scalar()).collect();
    assert!((losses[0] - init::START_OPACITY).abs() < 1e-6, "{losses:?}");
    assert!(losses[2] < losses[1] && losses[1] < losses[0], "{losses:?}");
    // The loss depends on opacities only, so no other parameter changes.
    let after = trainer.gaussians().to_rows();
    assert_eq!(GaussianRows { logit_opacities: before.logit_opacities.clone(), ..after }, before);
    let expected: Vec<_> = reports.into_iter().map(|report| (report.step, report.view)).collect();
    assert_eq!(*seen_views.borrow(), expected);
}

#[test]
fn what_cannot_start_says_what_to_do() {
    let fails = |photos: Vec<Photo>, config: TrainConfig, parts: &[&str]| {
        let error = Trainer::new(photos, &points(), config, &Device::flex()).err().expect("an error").to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    fails(photos([0.0; 3]), config(0), &["`steps` is 0", "--steps N"]);
    fails(photos([0.0; 3]), TrainConfig { batch: 0, ..config(1) }, &["`batch` is 0", "--batch N"]);
    fails(vec![], config(1), &["no photographs", "--test-every"]);
    fails(photos([0.0; 3]), TrainConfig { sh_degree: 5, ..config(1) }, &["`sh_degree` is 5", "0 to 4"]);
    let resolution = Resolution { coarsest_divisor: 3, full_from: 0.5 };
    fails(photos([0.0; 3]), TrainConfig { resolution, ..config(1) }, &["3 from 0.5", "power of two", "--coarsest"]);
}

#[test]
fn the_cache_changes_no_result() {
    let cached = |cache_mib| {
        let mut trainer = trainer(TrainConfig { cache_mib, ..eventful() });
        (0..4).for_each(|_| drop(trainer.step().unwrap()));
        (trainer.views.kept(), run(self::trainer(TrainConfig { cache_mib, ..eventful() })))
    };
    let ((kept_none, without), (kept_all, with)) = (cached(0), cached(512));
    assert_eq!((kept_none, kept_all), (0, 4));
    assert_eq!(without, with);
}

#[test]
fn the_cache_stops_when_it_is_full() {
    let mut trainer = trainer(config(8));
    // Memory for two and a half photographs.
    trainer.views.leave_room(5 * (3 * size_of::<f32>() * WIDTH * HEIGHT * 3) / 2);
    (0..8).for_each(|_| drop(trainer.step().unwrap()));
    assert_eq!(trainer.views.kept(), 2);
}

#[test]
fn photographs_grow_to_their_full_size() {
    let photos = photos([0.0; 3]).iter().map(|photo| photo.resized(8 * WIDTH, 8 * HEIGHT)).collect();
    let resolution = Resolution { coarsest_divisor: 4, full_from: 0.5 };
    let trainer = Trainer::new(photos, &points(), TrainConfig { resolution, ..config(8) }, &Device::flex()).unwrap();
    let divisors = Rc::new(RefCell::new(Vec::new()));
    let seen_by = divisors.clone();
    let loss = move |seen: &LossInputs| {
        let [height, width, _] = seen.image.dims();
        assert_eq!([height, width, 3], seen.truth.image().dims());
        assert_eq!(8 * WIDTH * height, 8 * HEIGHT * width);
        seen_by.borrow_mut().push(8 * WIDTH / width);
        photometric(seen.image.clone(), seen.truth, 0.2)
    };
    run(trainer.with_loss(loss));
    assert_eq!(*divisors.borrow(), [4, 4, 2, 2, 1, 1, 1, 1]);
}

/// Trains on a photograph with pixels of every opacity, the first of them transparent, and a scene that leaves the first
/// pixel empty.
fn cut_out(config: TrainConfig, loss: impl Fn(&LossInputs, &Photo) + 'static) {
    let mut photo = photos([0.0; 3]).remove(0);
    photo.alpha = Some((0..WIDTH * HEIGHT).map(|i| (i % 256) as u8).collect());
    let points = PointCloud { positions: vec![[0.0; 3], [0.01; 3]], colours: vec![[128; 3]; 2] };
    let trainer = Trainer::new(vec![photo.clone()], &points, config, &Device::flex()).unwrap();
    let checked = move |seen: &LossInputs| {
        assert_eq!(values_of(seen.alpha.clone())[0], 0.0);
        loss(seen, &photo);
        seen.image.clone().mean()
    };
    run(trainer.with_loss(checked));
}

#[test]
fn alpha_shows_the_background_and_so_does_the_scene() {
    for background in [[0.0; 3], [1.0; 3], [0.2, 0.5, 0.9]] {
        cut_out(TrainConfig { background, ..config(1) }, move |seen, photo| {
            let alpha = photo.alpha.as_ref().unwrap();
            let over = |(i, byte): (usize, &u8)| {
                let alpha = f32::from(alpha[i / 3]) / 255.0;
                f32::from(*byte) / 255.0 * alpha + background[i % 3] * (1.0 - alpha)
            };
            let expected = photo.rgb.iter().enumerate().map(over);
            let truth = values_of(seen.truth.image());
            assert!(truth.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6));
            assert_eq!(values_of(seen.image.clone())[..3], background);
        });
    }
}

#[test]
fn a_random_background_is_another_at_each_step_and_shows_behind_both() {
    let drawn = Rc::new(RefCell::new(Vec::new()));
    let list = drawn.clone();
    cut_out(TrainConfig { backdrop: Backdrop::Random, ..config(6) }, move |seen, _| {
        let [image, truth] = [seen.image.clone(), seen.truth.image()].map(|image| values_of(image)[..3].to_vec());
        assert!(image.iter().zip(&truth).all(|(image, truth)| (image - truth).abs() < 1e-6), "{image:?} {truth:?}");
        list.borrow_mut().push(image);
    });
    let drawn = drawn.borrow();
    let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 0.05);
    assert!(drawn.len() == 6 && drawn.windows(2).all(|pair| apart(&pair[0], &pair[1])), "{drawn:?}");
}

#[test]
fn harmonics_grow_by_the_calendar() {
    let mut trainer = trainer(TrainConfig { sh_every: 2, sh_degree: 2, ..config(7) });
    let mut degree = || {
        trainer.step().unwrap();
        trainer.gaussians().sh_degree()
    };
    assert_eq!(std::array::from_fn::<usize, 7, _>(|_| degree()), [0, 0, 1, 1, 2, 2, 2]);
}

#[test]
fn a_scene_that_loses_all_its_gaussians_ends_the_run() {
    let density = AdaptiveConfig { prune_opacity: 2.0, ..EVENTFUL };
    let mut trainer = trainer(TrainConfig { density: density.into(), ..eventful() });
    let counts: Vec<usize> = (0..4).map(|_| trainer.step().unwrap().splats).collect();
    assert_eq!(counts, [30; 4]);
    let message = trainer.step().unwrap_err().to_string();
    assert_eq!(message, "step 5: no splat is left, so the run ends: photographs show all 30 points");
}

#[test]
fn a_weight_on_opacity_fades_gaussians() {
    let mean_logit = |opacity_weight| {
        let (_, rows) = run(trainer(TrainConfig { opacity_weight, ..config(24) }));
        rows.logit_opacities.iter().sum::<f32>() / rows.len() as f32
    };
    let (without, with) = (mean_logit(0.0), mean_logit(1.0));
    assert!(with < without - 0.2, "mean logit {with} with the weight, {without} without");
}

/// Steps 1 to 5 of 12 have the weight where growth ends at a half, all steps but the last where it ends with the run.
#[test]
fn the_weight_on_opacity_ends_with_density_control() {
    // Nothing moves, so that losses differ by the weight alone.
    let learning_rates = LearningRates {
        means: 0.0,
        scales: 0.0,
        rotations: 0.0,
        sh_dc: 0.0,
        sh_rest: 0.0,
        opacities: 0.0,
        ..LearningRates::default()
    };
    for (until_share, last) in [(0.5, 5), (1.0, 11), (0.0, 0)] {
        let density = AdaptiveConfig { until_share, ..AdaptiveConfig::default() }.into();
        let still = |opacity_weight| TrainConfig { density, opacity_weight, learning_rates, ..config(12) };
        let losses = |opacity_weight| run(trainer(still(opacity_weight))).0;
        let raised: Vec<bool> = losses(0.0).iter().zip(losses(1.0)).map(|(without, with)| with > *without).collect();
        let expected: Vec<bool> = (1..=12).map(|step| step <= last).collect();
        assert_eq!(raised, expected, "until {until_share}");
    }
}

#[test]
fn who_looks_into_a_step_sees_what_it_trained() {
    let (mut alone, mut seen) = (trainer(eventful()), trainer(eventful()));
    let mut refined = Vec::new();
    while !seen.is_done() {
        let mut looks = Vec::new();
        let before = seen.gaussians().len();
        let report =
            seen.step_and_look(|trainer| looks.push((trainer.steps_done(), trainer.gaussians().len()))).unwrap();
        // Density control comes after the look.
        assert_eq!(looks, [(report.step, before)]);
        refined.extend(report.refined.map(|_| report.step));
        alone.step().unwrap();
    }
    assert_eq!(refined, [5, 10, 15, 20]);
    assert_eq!(seen.gaussians().to_rows(), alone.gaussians().to_rows());
}

#[test]
fn the_look_of_a_step_without_refinement_is_the_scene_after_it() {
    // The noise of MCMC follows every optimiser step.
    let density = McmcConfig { every: 5, from: 5, ..McmcConfig::default() };
    let mut trainer = trainer(TrainConfig { density: density.into(), ..config(4) });
    while !trainer.is_done() {
        let mut seen = None;
        trainer.step_and_look(|trainer| seen = Some(trainer.gaussians().to_rows())).unwrap();
        assert_eq!(seen.unwrap(), trainer.gaussians().to_rows());
    }
}

/// All cameras look away from the points, as with axes of another convention: nothing is rendered, and the penalty on opacities lets all
/// Gaussians fade.
#[test]
fn a_run_without_splats_says_that_no_photograph_shows_the_points() {
    let mut photos = photos([0.0; 3]);
    for photo in &mut photos {
        photo.cam_from_world = DAffine3::from_rotation_y(std::f64::consts::PI) * photo.cam_from_world;
    }
    let config = TrainConfig { opacity_weight: 10.0, density: EVENTFUL.into(), ..config(200) };
    let mut trainer = Trainer::new(photos, &points(), config, &Device::flex()).unwrap();
    let error = loop {
        if let Err(error) = trainer.step() {
            break error;
        }
    };
    let message = error.to_string();
    assert!(matches!(error, TrainError::NoSplats { .. }) && !error.keeps_scene(), "{message}");
    for part in ["no splat is left", "no photograph shows 30 of the 30 points", "OpenGL", "another world"] {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

#[test]
fn points_at_one_place_start_as_one_gaussian() {
    let four = |by: f32| {
        let moved = |i: usize, point: &[f32; 3]| point.map(|x| x * (1.0 + by * i as f32));
        let of = |point: &[f32; 3]| (0..4).map(|i| moved(i, point)).collect::<Vec<_>>();
        let positions: Vec<[f32; 3]> = points().positions.iter().flat_map(of).collect();
        PointCloud { colours: vec![[128; 3]; positions.len()], positions }
    };
    let start =
        |points: &PointCloud| Trainer::new(photos([0.0; 3]), points, config(1), &Device::flex()).unwrap().rows();
    let once = start(&points());
    assert_eq!(once.len(), 30);
    for by in [0.0, f32::EPSILON] {
        let found = start(&four(by));
        assert_eq!((found.len(), &found.means), (30, &once.means), "{by}");
        let near = |(a, b): (&[f32; 3], &[f32; 3])| (a[0] - b[0]).abs() < 1e-4;
        assert!(found.log_scales.iter().zip(&once.log_scales).all(near), "{by}");
    }
    let nowhere = PointCloud { positions: vec![[f32::NAN; 3]; 9], colours: vec![[0; 3]; 9] };
    assert_eq!(start(&nowhere).len(), init::RANDOM_COUNT, "no point has a position: random ones");
}
