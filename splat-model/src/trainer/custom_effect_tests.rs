//! Runs with custom effects.

use std::cell::RefCell;
use std::rc::Rc;

use burn::tensor::Gradients as Remaining;
use rand::{Rng, RngExt};
use splat_op::Rendered;

use super::testing::{photos, points};
use super::*;
use crate::density::AdaptiveConfig;
use crate::effects::background::Background;
use crate::effects::{Learned, RenderInput};
use crate::gaussians::{GaussianRows, values_of};
use crate::state::{State, StateError};

type Log = Rc<RefCell<Vec<String>>>;

/// An effect that logs its calls and learns a number from its penalty, or from the picture.
struct Noted {
    name: &'static str,
    log: Log,
    number: Learned<1>,
    /// State other than the number.
    drawn: [f32; 3],
    /// Number of renders for one input.
    samples: usize,
}

impl Noted {
    fn new(name: &'static str, log: &Log) -> Self {
        let number = Learned::new(Tensor::zeros([1], &Device::flex()));
        Self { name, log: log.clone(), number, drawn: [0.0; 3], samples: 1 }
    }

    fn note(&self, what: &str) {
        self.log.borrow_mut().push(format!("{what} {}", self.name));
    }
}

impl Effect for Noted {
    fn name(&self) -> &'static str {
        self.name
    }

    fn draw(&mut self, rng: &mut dyn Rng) -> Option<[f32; 3]> {
        self.note("draw");
        self.drawn = [0, 1, 2].map(|_| rng.random_range(0.0..0.1));
        Some(self.drawn)
    }

    fn before(&mut self, input: &mut RenderInput, gaussians: &Gaussians, _: EffectContext) {
        self.note("before");
        assert_eq!(input.splats.means.dims()[0], gaussians.len());
        let (name, log) = (self.name, self.log.clone());
        input.edit(move |ellipses| {
            log.borrow_mut().push(format!("edit {name}"));
            ellipses
        });
    }

    fn samples(&mut self, input: RenderInput, _: EffectContext) -> Vec<RenderInput> {
        self.note("samples");
        vec![input; self.samples]
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, picture: &Rendered<3>, _: EffectContext) -> Tensor<3> {
        self.note("image");
        assert_eq!(image.dims()[..2], picture.alpha.dims()[..2]);
        image * (self.number.tracked() * 0.1 + 1.0).reshape([1, 1, 1])
    }

    fn penalty(&mut self, _: &RenderInput, _: &Rendered<3>, _: EffectContext) -> Option<Tensor<1>> {
        self.note("penalty");
        Some((self.number.tracked() - 3.0).square() * 10.0)
    }

    fn step(&mut self, gradients: &mut Remaining, at: EffectContext) {
        self.note("step");
        assert!(self.number.step(gradients, 0.25, at.verdict), "the loss depends on it");
    }

    fn forget_rows(&mut self) {
        self.note("forget");
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        to.tell("drawn", &self.drawn)?;
        self.number.save(to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        self.drawn = from.told("drawn")?;
        self.number.load(from)
    }

    fn bake(&self, rows: &mut GaussianRows) {
        rows.logit_opacities.fill(values_of(self.number.value())[0]);
    }

    fn background(&self) -> Option<Background> {
        Some(Background::Colour(self.drawn))
    }
}

fn config() -> TrainConfig {
    let density =
        AdaptiveConfig { every: 5, from: 5, grad_threshold: 1e-5, max_splats: 60, ..AdaptiveConfig::default() };
    TrainConfig { steps: 16, density: density.into(), ..TrainConfig::default() }
}

fn trainer(config: TrainConfig) -> Trainer {
    Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap()
}

#[test]
fn hooks_are_called_in_the_documented_order() {
    let log = Log::default();
    let [first, mut second] = ["first", "second"].map(|name| Noted::new(name, &log));
    second.samples = 2;
    let mut run = trainer(TrainConfig { batch: 2, ..config() }).with_effect(first).with_effect(second);
    run.step().unwrap();
    let view = "draw first draw second before first before second samples first samples second \
                edit first edit second edit first edit second \
                image first image second penalty first penalty second";
    let steps = "step first step second";
    assert_eq!(log.take().join(" "), [view, view, steps, steps].join(" "));
    (1..5).for_each(|_| _ = run.step().unwrap());
    let refined = log.take();
    assert_eq!(refined[refined.len() - 2..], ["forget first", "forget second"]);
    let [first, second] = ["first", "second"].map(|name| Noted::new(name, &log));
    // A second effect of a name replaces the first.
    let run = trainer(config()).with_effect(first).with_effect(second).with_effect(Noted::new("first", &log));
    let mut run = run;
    run.step().unwrap();
    assert_eq!(log.take()[..2], ["draw first", "draw second"]);
}

#[test]
fn a_penalty_reaches_the_parameter_of_its_effect() {
    let mut run = trainer(config()).with_effect(Noted::new("one", &Log::default()));
    let number = |run: &Trainer| values_of(run.effect::<Noted>().unwrap().number.value())[0];
    run.step().unwrap();
    assert!(
        (number(&run) - 0.25).abs() < 1e-6,
        "Adam's first step is as long as its rate, towards 3: {}",
        number(&run)
    );
    while !run.is_done() {
        run.step().unwrap();
    }
    assert!((number(&run) - 3.0).abs() < 0.7, "{}", number(&run));
    // The number that the effect writes for other renderers.
    assert!(run.rows().logit_opacities.iter().all(|logit| *logit == number(&run)));
    assert!(matches!(run.background(), Background::Colour(drawn) if drawn != [0.0; 3]));
}

#[test]
fn a_state_survives_to_the_bit() {
    let new = || trainer(config()).with_effect(Noted::new("one", &Log::default()));
    let end = |mut run: Trainer| {
        while !run.is_done() {
            run.step().unwrap();
        }
        run.save().unwrap()
    };
    let expected = end(new());
    assert!(expected.has("effects/one/value") && expected.has("effects/one/drawn"));
    for after in [1, 7] {
        let mut first = new();
        (0..after).for_each(|_| _ = first.step().unwrap());
        let mut second = new();
        second.resume(first.save().unwrap()).unwrap();
        assert!(end(second) == expected, "after {after} steps");
    }
    // A run without the effect refuses the state instead of dropping a part.
    let error = trainer(config()).resume(new().save().unwrap()).unwrap_err().to_string();
    assert!(error.contains("effects/one"), "{error}");
}

/// Two equal renders have the mean of one.
#[test]
fn the_mean_of_equal_renders_is_the_render() {
    let losses = |samples: usize| {
        let mut run = trainer(config()).with_effect(Noted { samples, ..Noted::new("one", &Log::default()) });
        (0..4).map(|_| run.step().unwrap().loss.into_scalar::<f32>()).collect::<Vec<_>>()
    };
    assert_eq!(losses(2), losses(1));
}
