//! Groups of one's own in a run: features that a loss renders and compares.

use super::ranks::testing::together;
use super::testing::{photos, points};
use super::*;
use crate::density::{AdaptiveConfig, DensityConfig, Division, Mcmc, McmcConfig};
use crate::gaussians::{GroupRows, values_of};

/// Strategies that change rows in a few dozen steps.
fn strategies() -> [DensityConfig; 4] {
    let adaptive = AdaptiveConfig {
        every: 5,
        from: 5,
        until_share: 0.9,
        grad_threshold: 1e-5,
        max_splats: 45,
        ..AdaptiveConfig::default()
    };
    let mcmc = McmcConfig { every: 5, from: 5, growth: 1.2, max_splats: 60, ..McmcConfig::default() };
    let absgrad = AdaptiveConfig { absolute: true, ..adaptive };
    let gradual = AdaptiveConfig { division: Division::LongAxis, growth: Some(0.2), ..adaptive };
    [adaptive.into(), mcmc.into(), absgrad.into(), gradual.into()]
}

/// A run that also learns the photographs as features of a group.
fn run(density: DensityConfig, batch: usize) -> Trainer {
    let config = TrainConfig { steps: 24, batch, density, ..TrainConfig::default() };
    let options = GroupOptions { rate: 0.05, final_share: 0.1, ..GroupOptions::default() };
    let trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
    trainer.with_group("features", 3, options).unwrap().with_loss(|seen: &LossInputs| {
        let features = seen.features(seen.group("features")).unwrap();
        photometric(seen.image.clone(), seen.truth, 0.2) + (features - seen.truth.image()).abs().mean()
    })
}

fn features(trainer: &Trainer) -> GroupRows {
    trainer.gaussians().to_rows().groups.remove(0)
}

#[test]
fn a_loss_trains_a_group_through_density_control() {
    for density in strategies() {
        let mut trainer = run(density, 1);
        let losses: Vec<f32> = (0..24).map(|_| trainer.step().unwrap().loss.into_scalar::<f32>()).collect();
        let [first, last] = [&losses[..4], &losses[20..]].map(|part| part.iter().sum::<f32>());
        assert!(last < 0.95 * first, "{losses:?}");
        let found = features(&trainer);
        assert_ne!(trainer.gaussians().len(), 30, "density control changed rows");
        assert_eq!(found.values.len(), 3 * trainer.gaussians().len());
        assert!(found.values.iter().any(|value| *value > 0.1));
        let values = trainer.gaussians().group("features").unwrap().values();
        assert_eq!(values_of(values), found.values);
    }
}

#[test]
fn a_run_with_a_group_resumes() {
    for density in strategies() {
        let (mut whole, mut resumed) = (run(density, 1), run(density, 1));
        (0..12).for_each(|_| drop(whole.step().unwrap()));
        let state = whole.save().unwrap();
        resumed.resume(state.clone()).unwrap();
        while !whole.is_done() {
            whole.step().unwrap();
            resumed.step().unwrap();
        }
        assert_eq!(resumed.gaussians().to_rows(), whole.gaussians().to_rows());
        let config = TrainConfig { steps: 24, density, ..TrainConfig::default() };
        let mut without = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
        let error = without.resume(state).unwrap_err().to_string();
        assert!(error.contains("further groups") && error.contains("features [3]"), "{error}");
    }
}

#[test]
fn ranks_share_the_gradients_of_a_group() {
    let density = strategies()[0];
    let mut alone = run(density, 2);
    while !alone.is_done() {
        alone.step().unwrap();
    }
    let expected = alone.gaussians().to_rows();
    let found = together(2, |ranks| {
        let mut trainer = run(density, 2).with_ranks(ranks);
        while !trainer.is_done() {
            trainer.step().unwrap();
        }
        trainer.gaussians().to_rows()
    });
    assert!(found.into_iter().all(|rows| rows == expected));
}

#[test]
fn a_strategy_of_ones_own_keeps_the_groups() {
    let before = run(strategies()[0], 1);
    let expected = features(&before);
    let after = before.with_strategy(Mcmc::new(McmcConfig::default(), 1.0, 24)).unwrap();
    assert_eq!(features(&after), expected);
}

#[test]
fn a_scene_brings_its_groups() {
    let mut trained = run(strategies()[0], 1);
    (0..6).for_each(|_| drop(trained.step().unwrap()));
    let scene = trained.rows();
    let config = TrainConfig { steps: 6, ..TrainConfig::default() };
    let options = GroupOptions { rate: 0.1, ..GroupOptions::default() };
    let start = || Trainer::new(photos([0.0; 3]), &points(), config.clone(), &Device::flex()).unwrap();
    let started = start().from_scene(&scene, &points()).unwrap().with_group("features", 3, options).unwrap();
    let found = features(&started);
    let new = found.values.len() - scene.groups[0].values.len();
    assert!(new > 0 && found.values[..new].iter().all(|value| *value == 0.0));
    assert_eq!(found.values[new..], scene.groups[0].values);
    assert_eq!(found.options, options);
    // In the other order it is the same.
    let other = start().with_group("features", 3, options).unwrap().from_scene(&scene, &points()).unwrap();
    assert_eq!(features(&other), found);
    // A group that came with the scene is no obstacle to resuming.
    let mut carried = start().from_scene(&scene, &points()).unwrap();
    carried.scene.gaussians.groups[5].set_options(GroupOptions::default());
    carried.step().unwrap();
    let state = carried.save().unwrap();
    let mut resumed = start();
    resumed.resume(state).unwrap();
    assert_eq!(resumed.gaussians().to_rows(), carried.gaussians().to_rows());
    let error = start().from_scene(&scene, &points()).unwrap().with_group("features", 4, options).err().unwrap();
    assert!(error.to_string().contains("two groups are named `features`"), "{error}");
}
