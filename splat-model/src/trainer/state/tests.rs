use burn::tensor::Device;

use super::*;
use crate::density::{AdaptiveConfig, McmcConfig};
use crate::effects::background::Backdrop;
use crate::effects::exposure::ExposureConfig;
use crate::effects::grid::GridConfig;
use crate::effects::optics::OpticsConfig;
use crate::effects::pose::PoseConfig;
use crate::optim::MomentBits;
use crate::trainer::testing::{photos, points};

/// A short run in which Gaussians are added and removed, and opacities are reset.
fn eventful() -> TrainConfig {
    let density = AdaptiveConfig {
        every: 5,
        from: 5,
        until_share: 0.9,
        grad_threshold: 1e-5,
        reset_every: 14,
        max_splats: 60,
        ..AdaptiveConfig::default()
    };
    TrainConfig { steps: 24, sh_every: 6, density: density.into(), ..TrainConfig::default() }
}

/// The same run with all learned effects.
fn with_effects() -> TrainConfig {
    TrainConfig {
        exposure: Some(ExposureConfig::default()),
        grid: Some(GridConfig::default()),
        poses: Some(PoseConfig::default()),
        optics: OpticsConfig { motion: true, rolling: true },
        smoothing: true,
        antialias: true,
        backdrop: Backdrop::Environment { degree: 1 },
        ..eventful()
    }
}

fn trainer(config: &TrainConfig) -> Trainer {
    Trainer::new(photos(config.background), &points(), config.clone(), &Device::flex()).unwrap()
}

/// The final state.
fn end(mut trainer: Trainer) -> State {
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    trainer.save().unwrap()
}

/// Trains `after` steps, saves the run, and finishes it in another trainer.
fn interrupted(config: &TrainConfig, after: usize) -> State {
    let mut first = trainer(config);
    (0..after).for_each(|_| _ = first.step().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    first.save().unwrap().write(&path).unwrap();
    let mut second = trainer(config);
    second.resume(State::read(&path).unwrap()).unwrap();
    assert_eq!(second.steps_done(), after);
    end(second)
}

#[test]
fn an_interrupted_run_ends_as_the_other() {
    let config = eventful();
    let expected = end(trainer(&config));
    for after in [0, 1, 4, 5, 7, 13, 14, 18, 23, 24] {
        assert!(interrupted(&config, after) == expected, "after {after} steps");
    }
}

/// Rounding depends on a number's place and on the step alone, whose rows move and whose harmonics grow meanwhile.
#[test]
fn so_does_one_with_packed_moments() {
    let config = TrainConfig { moment_bits: MomentBits::Eight, ..eventful() };
    let expected = end(trainer(&config));
    for after in [0, 5, 13, 14, 20] {
        assert!(interrupted(&config, after) == expected, "after {after} steps");
    }
}

#[test]
fn so_does_one_of_any_strategy_and_of_batches() {
    let mcmc = McmcConfig { every: 5, from: 5, growth: 1.2, max_splats: 60, ..McmcConfig::default() };
    let eager = |config| AdaptiveConfig { every: 5, from: 5, grad_threshold: 1e-5, max_splats: 60, ..config };
    for density in [mcmc.into(), eager(AdaptiveConfig::absgrad()).into()] {
        let config = TrainConfig { density, batch: 2, ..eventful() };
        let expected = end(trainer(&config));
        for after in [3, 8, 10] {
            assert!(interrupted(&config, after) == expected, "{density:?} after {after} steps");
        }
    }
}

#[test]
fn so_does_one_with_effects() {
    for config in [with_effects(), TrainConfig { backdrop: Backdrop::Random, ..eventful() }] {
        let expected = end(trainer(&config));
        for after in [3, 11] {
            assert!(interrupted(&config, after) == expected, "after {after} steps");
        }
    }
    let learned = TrainConfig { backdrop: Backdrop::Learned, ..eventful() };
    assert!(interrupted(&learned, 9) == end(trainer(&learned)));
}

#[test]
fn other_runs_are_refused() {
    let config = eventful();
    let state = || trainer(&config).save().unwrap();
    let refused = |mut other: Trainer, state: State| other.resume(state).unwrap_err().to_string();
    let seeded = TrainConfig { seed: 9, ..config.clone() };
    let error = refused(trainer(&seeded), state());
    assert!(error.contains("`seed` is 9, and was 0"), "{error}");

    let mut fewer = photos([0.0; 3]);
    fewer.pop();
    let other = Trainer::new(fewer, &points(), config.clone(), &Device::flex()).unwrap();
    let error = refused(other, state());
    assert!(error.contains("photograph 4 is none, and was b (32 x 24)"), "{error}");

    let mut lacking = state();
    drop(lacking.take_part("density"));
    drop(lacking.take_part("scene"));
    assert!(refused(trainer(&config), lacking).contains("means/values"));
    let mut too_much = state();
    too_much.tell("effects/tides", &1).unwrap();
    assert!(refused(trainer(&config), too_much).contains("tides"));
    let mut wrong = state();
    wrong.tell("queue", &[4]).unwrap();
    assert!(refused(trainer(&config), wrong).contains("queue"));
}

#[test]
fn random_numbers_go_on() {
    use rand::{RngExt, SeedableRng};
    let (mut rng, mut state) = (ChaCha8Rng::seed_from_u64(3), State::default());
    for _ in 0..37 {
        rng.random::<u32>();
        state.tell("random", &rng).unwrap();
        let mut resumed: ChaCha8Rng = state.told("random").unwrap();
        assert_eq!(resumed.random::<u64>(), rng.clone().random::<u64>());
    }
}
