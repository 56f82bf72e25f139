//! Losses with outputs, state and batches of their own.

use burn::nn::{Linear, LinearConfig};
use burn::tensor::Gradients as Remaining;
use splat_op::{Rendered, normals, render_view};

use super::ranks::testing::together;
use super::testing::{photos, points};
use super::*;
use crate::density::AdaptiveConfig;
use crate::effects::{Leaf, Network, RenderInput};
use crate::gaussians::values_of;
use crate::state::{State, StateError};

fn config(steps: usize, batch: usize) -> TrainConfig {
    let density = AdaptiveConfig { every: 5, from: 5, grad_threshold: 1e-5, ..AdaptiveConfig::default() };
    TrainConfig { steps, batch, density: density.into(), ..TrainConfig::default() }
}

fn trainer(config: TrainConfig) -> Trainer {
    Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap()
}

/// Compares pictures as a layer of a network, which it learns, shows them. From step `from` on it asks for depth and normals.
struct Toned {
    layer: Network<Linear>,
    from: usize,
    joins: bool,
    rate: f64,
}

impl Toned {
    fn new(from: usize, joins: bool) -> Self {
        let mut layer = LinearConfig::new(3, 3).with_bias(false).init(&Device::flex());
        layer.weight = layer.weight.map(|weight| Tensor::eye(weight.dims()[0], &weight.device()));
        Self { layer: Network::new(layer), from, joins, rate: 0.01 }
    }
}

impl Loss for Toned {
    fn outputs(&self, options: RenderOptions, step: usize) -> RenderOptions {
        let asked = step >= self.from;
        options.with_depth(asked).with_normals(asked)
    }

    fn loss(&mut self, seen: &LossInputs) -> Tensor<1> {
        let asked = seen.step >= self.from;
        assert_eq!([seen.depth.is_some(), seen.normals.is_some()], [asked; 2], "step {}", seen.step);
        if let Some(planes) = &seen.normals {
            let LossInputs { input: RenderInput { splats, camera, .. }, .. } = seen;
            let expected = seen.features(normals(splats, camera).unwrap()).unwrap();
            assert!((planes.clone() - expected).abs().max().into_scalar::<f32>() < 1e-5);
            let plain = seen.input.options.with_normals(false);
            let depth = render_view(splats, camera, &seen.input.extras, &plain).unwrap().depth.unwrap();
            assert_eq!(values_of(seen.depth.clone().unwrap().inner()), values_of(depth.inner()));
        }
        let image = self.layer.tracked().forward(seen.image.clone());
        (image - seen.truth.image()).square().mean()
    }

    fn joins_views(&self) -> bool {
        self.joins
    }

    fn leaves(&mut self) -> Vec<Leaf> {
        self.layer.leaves()
    }

    fn step(&mut self, gradients: &mut Remaining, at: EffectContext) {
        self.layer.step(gradients, self.rate, at.verdict);
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.layer.save(to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        self.layer.load(from)
    }
}

/// Moves no ellipse, but has the stages run one by one.
struct Staged;

impl Effect for Staged {
    fn name(&self) -> &'static str {
        "staged"
    }

    fn before(&mut self, input: &mut RenderInput, _: &Gaussians, _: EffectContext) {
        input.edit(|ellipses| ellipses);
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, picture: &Rendered<3>, _: EffectContext) -> Tensor<3> {
        assert_eq!(picture.normals.is_some(), picture.depth.is_some());
        image
    }
}

fn done(mut trainer: Trainer) -> Trainer {
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    trainer
}

fn weights(trainer: &Trainer) -> Vec<f32> {
    values_of(trainer.loss::<Toned>().unwrap().layer.value().weight.val())
}

#[test]
fn a_loss_gets_the_outputs_that_it_asks_for() {
    done(trainer(config(4, 1)).with_loss(Toned::new(3, false)));
    done(trainer(config(4, 1)).with_loss(Toned::new(2, false)).with_effect(Staged));
    // A function asks for nothing.
    let plain = |seen: &LossInputs| {
        assert!(seen.depth.is_none() && seen.normals.is_none());
        seen.image.clone().mean()
    };
    done(trainer(config(2, 1)).with_loss(plain));
}

#[test]
fn a_losss_parameters_are_trained_and_saved() {
    let make = || trainer(config(12, 1)).with_loss(Toned::new(99, false));
    let (whole, mut half, mut resumed) = (done(make()), make(), make());
    assert!(weights(&whole).iter().zip(weights(&half)).all(|(a, b)| (a - b).abs() > 1e-3), "{:?}", weights(&whole));
    (0..6).for_each(|_| drop(half.step().unwrap()));
    let state = half.save().unwrap();
    resumed.resume(state.clone()).unwrap();
    let resumed = done(resumed);
    assert_eq!(weights(&resumed), weights(&whole));
    assert_eq!(resumed.gaussians().to_rows(), whole.gaussians().to_rows());
    let error = trainer(config(12, 1)).resume(state).unwrap_err().to_string();
    assert!(error.contains("loss/"), "{error}");
}

#[test]
fn ranks_share_a_losss_parameters() {
    let make = || trainer(config(8, 2)).with_loss(Toned::new(99, false));
    let alone = done(make());
    for count in [2, 3] {
        let all = together(count, |ranks| {
            let trainer = done(make().with_ranks(ranks));
            (weights(&trainer), trainer.gaussians().to_rows())
        });
        assert!(all.iter().all(|found| *found == (weights(&alone), alone.gaussians().to_rows())), "{count} ranks");
    }
}

/// Views that a loss joins without comparing them are trained as one by one, but for rounding.
#[test]
fn joined_views_are_those_of_the_batch() {
    let losses = |joins| {
        let mut trainer = trainer(config(12, 3)).with_loss(Toned { rate: 0.0, ..Toned::new(2, joins) });
        let losses: Vec<f32> = (0..6).map(|_| trainer.step().unwrap().loss.into_scalar::<f32>()).collect();
        (losses, trainer.gaussians().len(), trainer.gaussians().to_rows().means[3])
    };
    let (apart, together) = (losses(false), losses(true));
    assert_eq!(apart.0[0], together.0[0], "before a step");
    assert_eq!(apart.1, together.1, "density control sees the same signals");
    assert!(apart.1 > 30, "{apart:?}");
    for (a, b) in apart.0.iter().zip(&together.0) {
        assert!((a - b).abs() < 1e-3 * a, "{apart:?} {together:?}");
    }
}

/// Compares the brightness of two views of a step, which the photographs do not have.
struct Even;

impl Loss for Even {
    fn loss(&mut self, _: &LossInputs) -> Tensor<1> {
        unreachable!("the views are joined")
    }

    fn joins_views(&self) -> bool {
        true
    }

    fn of_batch(&mut self, seen: &[LossInputs]) -> Tensor<1> {
        let [a, b] = seen else { panic!("{} views", seen.len()) };
        assert_ne!(a.view, b.view);
        (a.image.clone() - b.image.clone()).mean().square()
    }
}

#[test]
fn a_loss_may_compare_views() {
    let still = TrainConfig {
        density: AdaptiveConfig { until_share: 0.0, ..AdaptiveConfig::default() }.into(),
        ..config(60, 2)
    };
    let mut run = trainer(still).with_loss(Even);
    let losses: Vec<f32> = (0..60).map(|_| run.step().unwrap().loss.into_scalar::<f32>()).collect();
    let [first, last] = [&losses[..6], &losses[54..]].map(|part| part.iter().sum::<f32>());
    assert!(last < 0.3 * first, "{losses:?}");
    let errors =
        together(2, |ranks| trainer(config(2, 2)).with_loss(Even).with_ranks(ranks).step().unwrap_err().to_string());
    assert!(errors.iter().all(|error| error.contains("compares the views")), "{errors:?}");
}
