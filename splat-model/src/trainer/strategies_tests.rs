//! Runs with each strategy, and with batches.

use super::testing::{photos, points};
use super::*;
use crate::density::rows::RowEdit;
use crate::density::{AdaptiveConfig, DensityConfig, Division, McmcConfig, Observed, Signals, rows_on};
use crate::gaussians::{GaussianRows, values_of};
use crate::optim::LearningRates;
use crate::state::{State, StateError};
use splat_op::Splats;

/// Each strategy with a schedule for runs of a few dozen steps.
fn strategies() -> [DensityConfig; 4] {
    // A cap, so that the order of the gradients matters.
    let adaptive = AdaptiveConfig { every: 5, from: 5, grad_threshold: 1e-5, max_splats: 45, ..Default::default() };
    let mcmc = McmcConfig {
        every: 5,
        from: 5,
        growth: 1.2,
        max_splats: 60,
        dead_opacity: 0.3,
        // A few steps are too short for growth from a tenth of the size, or for recovery from noise.
        start_scale: 1.0,
        noise: 1e3,
        ..McmcConfig::default()
    };
    [
        adaptive.into(),
        AdaptiveConfig { absolute: true, ..adaptive }.into(),
        AdaptiveConfig { division: Division::LongAxis, growth: Some(0.2), ..adaptive }.into(),
        mcmc.into(),
    ]
}

fn config(density: DensityConfig) -> TrainConfig {
    // The default learning rates are for thousands of steps.
    let learning_rates =
        LearningRates { sh_dc: 0.05, opacities: 0.05, scales: 0.02, rotations: 0.01, ..LearningRates::default() };
    TrainConfig { steps: 24, sh_every: 6, density, learning_rates, ..TrainConfig::default() }
}

fn trainer(config: TrainConfig) -> Trainer {
    Trainer::new(photos(config.background), &points(), config, &Device::flex()).unwrap()
}

/// Losses by step, reports of refinements, and the scene.
fn run(mut trainer: Trainer) -> (Vec<f32>, Vec<RefineReport>, GaussianRows) {
    let (mut losses, mut refined) = (Vec::new(), Vec::new());
    while !trainer.is_done() {
        let report = trainer.step().unwrap();
        losses.push(report.loss.into_scalar::<f32>());
        refined.extend(report.refined);
    }
    (losses, refined, trainer.gaussians().to_rows())
}

#[test]
fn every_strategy_is_decided_by_its_seed_bit_for_bit() {
    let mut scenes: Vec<GaussianRows> = Vec::new();
    for density in strategies() {
        let seeded = |seed| run(trainer(TrainConfig { seed, ..config(density) }));
        let (losses, refined, rows) = seeded(7);
        assert_eq!((losses, refined.clone(), rows.clone()), seeded(7), "{density:?}");
        assert_ne!(rows, seeded(8).2, "{density:?}");
        assert!(refined.iter().any(|report| report.cloned + report.split > 0), "{density:?}: {refined:?}");
        assert!(rows.len() > 30 && rows.len() <= 60, "{density:?}: {}", rows.len());
        assert!(!scenes.contains(&rows), "{density:?} is another strategy");
        scenes.push(rows);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    for density in strategies() {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(trainer(config(density))))
        };
        assert_eq!(on(1), on(3), "{density:?}");
    }
}

#[test]
fn every_strategy_learns() {
    for density in strategies() {
        let (losses, ..) = run(trainer(TrainConfig { steps: 40, ..config(density) }));
        let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
        let (first, last) = (mean(&losses[..4]), mean(&losses[36..]));
        assert!(last < 0.9 * first, "{density:?}: from {first} to {last}");
    }
}

/// A strategy that does only the requested changes, and logs its calls.
#[derive(Default)]
struct Told {
    observed: usize,
    acted: Vec<usize>,
}

impl Strategy for Told {
    fn start(&mut self, rows: &mut GaussianRows) {
        rows.logit_opacities.fill(1.0);
    }

    fn listens_at(&self, step: usize) -> Signals {
        Signals { gradient: step == 2, abs_gradient: step < 3 }
    }

    fn penalty(&self, splats: &Splats, step: usize) -> Option<Tensor<1>> {
        (step == 3).then(|| splats.opacities.clone().mean() * 100.0)
    }

    fn observe(&mut self, seen: Observed) {
        self.observed += 1;
        let lengths = |gradient: Option<Tensor<2>>| gradient.map(values_of);
        let (signed, absolute) = (lengths(seen.gradient), lengths(seen.abs_gradient).unwrap());
        assert_eq!(signed.is_some(), self.observed > 2, "asked for at the second step, of two views each");
        // The absolute value of a sum is at most the sum of the absolute values.
        let signed = signed.unwrap_or_default();
        assert!(signed.iter().zip(&absolute).all(|(signed, absolute)| signed.abs() <= absolute * 1.001 + 1e-12));
        assert!(absolute.iter().any(|value| *value > 0.0) && absolute.iter().all(|value| *value >= 0.0));
    }

    fn acts_at(&self, step: usize) -> bool {
        step == 4
    }

    fn act(
        &mut self,
        scene: &mut Trained,
        at: &StrategyContext,
        _: &mut dyn rand::Rng,
    ) -> Result<Option<RefineReport>, crate::gaussians::RowsError> {
        self.acted.push(at.step);
        assert_eq!((at.steps, self.acted.len()), (5, at.step));
        assert!(at.extent > 0.0 && at.means_rate > 0.0);
        if self.acts_at(at.step) {
            let device = Device::flex();
            scene.edit(&RowEdit::new(rows_on(&device, &[3, 1]), rows_on(&device, &[])))?;
            return Ok(Some(RefineReport::default()));
        }
        Ok(None)
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        to.tell("observed", &self.observed)
    }
}

#[test]
fn a_strategy_of_ones_own_is_told_what_it_asks_for() {
    let config = TrainConfig { steps: 5, batch: 2, ..config(DensityConfig::default()) };
    let mut run = trainer(config).with_strategy(Told::default()).unwrap();
    assert_eq!(run.gaussians().to_rows().logit_opacities, [1.0; 30]);
    let reports: Vec<StepReport> = (0..5).map(|_| run.step().unwrap()).collect();
    let losses: Vec<f32> = reports.iter().map(|report| report.loss.clone().into_scalar()).collect();
    // sigmoid(1) is 0.73.
    assert!(losses[2] > 60.0 && losses[1] < 1.0 && losses[3] < 1.0, "{losses:?}");
    assert_eq!(reports.iter().map(|report| report.splats).collect::<Vec<_>>(), [30, 30, 30, 2, 2]);
    assert!(reports[3].refined.is_some() && reports[4].refined.is_none());
    let mut state = State::default();
    run.density.save(&mut state).unwrap();
    assert_eq!(state.told::<usize>("observed").unwrap(), 4);
}

/// A run on copies of one photograph.
fn one_photo(copies: usize, config: TrainConfig) -> Trainer {
    let photos = vec![photos([0.0; 3]).remove(1); copies];
    Trainer::new(photos, &points(), config, &Device::flex()).unwrap()
}

#[test]
fn a_batch_of_one_view_twice_is_that_view() {
    let with = |batch| TrainConfig { batch, steps: 3, ..config(DensityConfig::default()) };
    let (mut one, mut two) = (one_photo(2, with(1)), one_photo(2, with(2)));
    (one.step, two.step) = (1, 1);
    let ([a, b], before) =
        ([&mut one, &mut two].map(|run| run.differentiate_batch().unwrap()), one.gaussians().to_rows());
    assert_eq!((a.passes.len(), b.passes.len()), (1, 2));
    assert_eq!(values_of(a.loss.clone()), values_of(b.loss.clone()));
    assert_eq!(values_of(a.gradients.get("means").unwrap()), values_of(b.gradients.get("means").unwrap()));
    assert_eq!(values_of(a.gradients.get("sh").unwrap()), values_of(b.gradients.get("sh").unwrap()));
    // Adam's first step has the size of its rate for any gradient, and the rate is √2 times as large.
    (one.step, two.step) = (0, 0);
    let [one, two] = [one, two].map(|mut run| {
        let loss = run.step().unwrap().loss.into_scalar::<f32>();
        let after = run.gaussians().to_rows();
        let moved = after.logit_opacities.iter().zip(&before.logit_opacities).map(|(after, before)| after - before);
        (loss, moved.collect::<Vec<f32>>())
    });
    assert_eq!(one.0, two.0);
    assert!(one.1.iter().any(|moved| moved.abs() > 0.02));
    for (one, two) in one.1.iter().zip(&two.1) {
        assert!((two - 2f32.sqrt() * one).abs() < 1e-5, "{two} and {one}");
    }
}

#[test]
fn a_batch_averages_its_views_and_visits_each_once_an_epoch() {
    let single = |seen: usize| TrainConfig { batch: seen, steps: 4, ..config(DensityConfig::default()) };
    let gradients = |batch: usize| {
        let mut run = trainer(single(batch));
        run.step = 1;
        run.differentiate_batch().unwrap()
    };
    // The mean over all four views is the mean of the single results.
    let all = gradients(4);
    let mut alone = trainer(single(1));
    alone.step = 1;
    let parts: Vec<Batch> = (0..4).map(|_| alone.differentiate_batch().unwrap()).collect();
    let mut views: Vec<usize> = all.passes.iter().map(|(views, _)| views[0]).collect();
    assert_eq!(views, parts.iter().map(|part| part.passes[0].0[0]).collect::<Vec<_>>());
    views.sort_unstable();
    assert_eq!(views, [0, 1, 2, 3]);
    let mean = |of: fn(&Batch) -> Vec<f32>| -> Vec<f32> {
        let sum = parts.iter().map(of).reduce(|a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect()).unwrap();
        sum.iter().map(|sum| sum / 4.0).collect()
    };
    let means: fn(&Batch) -> Vec<f32> = |batch| values_of(batch.gradients.get("means").unwrap());
    for (of, what) in
        [(means, "means"), (|batch| values_of(batch.loss.clone()), "loss")] as [(fn(&Batch) -> Vec<f32>, _); 2]
    {
        for (found, expected) in of(&all).iter().zip(mean(of)) {
            assert!(
                (found - expected).abs() <= 1e-6 * expected.abs().max(1e-6),
                "{what}: {found} instead of {expected}"
            );
        }
    }
    // Three views per step continue into the next epoch.
    let mut run = trainer(single(3));
    run.step = 1;
    let mut visited: Vec<usize> =
        (0..4).flat_map(|_| run.differentiate_batch().unwrap().passes).map(|(views, _)| views[0]).collect();
    visited.sort_unstable();
    assert_eq!(visited, [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]);
}

#[test]
fn batches_are_decided_by_the_seed_and_learn() {
    let batch = || run(trainer(TrainConfig { batch: 3, ..config(DensityConfig::default()) }));
    let (losses, refined, rows) = batch();
    assert_eq!((losses.clone(), refined, rows), batch());
    let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
    assert!(mean(&losses[20..]) < 0.9 * mean(&losses[..4]), "{losses:?}");
}

#[test]
fn a_run_of_another_length_is_the_run_begun_with_it() {
    for density in strategies() {
        let expected = run(trainer(config(density)));
        let mut begun = trainer(TrainConfig { steps: 90, sh_every: 30, ..config(density) });
        begun.reschedule(&config(density)).unwrap();
        assert_eq!(run(begun), expected, "{density:?}");
    }
}

#[test]
fn a_run_may_change_its_length_while_it_goes_on() {
    for density in strategies() {
        let mut trainer = trainer(TrainConfig { steps: 90, ..config(density) });
        (0..10).for_each(|_| drop(trainer.step().unwrap()));
        assert!(matches!(trainer.reschedule(&TrainConfig { steps: 10, ..config(density) }), Err(TrainError::NoSteps)));
        assert_eq!(trainer.config().steps, 90);
        let growth = (1..=90).filter(|&step| trainer.refines_at(step)).count();
        trainer.reschedule(&config(density)).unwrap();
        assert_eq!(trainer.config().steps, config(density).steps);
        assert!((1..=90).filter(|&step| trainer.refines_at(step)).count() < growth);
        run(trainer);
    }
}
