use super::super::testing::{photos, points};
use super::super::{LossInputs, TrainConfig, TrainError, Trainer};
use super::*;
use crate::density::AdaptiveConfig;
use crate::density::rows::GroupGradients;
use crate::gaussians::GaussianRows;
use crate::loss::{DEFAULT_LAMBDA, photometric};

fn number(value: f32) -> Tensor<1> {
    Tensor::from_floats([value], &Device::flex())
}

fn gradients(logit: f32) -> Gradients {
    let sound = Gradients::default().with("means", Tensor::<2>::zeros([1, 3], &Device::flex()));
    sound.with("logit_opacities", number(logit))
}

/// A guard as on a GPU, which computes asynchronously.
fn waiting() -> Guard {
    Guard { waits: true, ..Guard::new(&Device::flex()) }
}

#[test]
fn where_nothing_is_waited_for_the_step_is_refused_at_once() {
    let mut guard = Guard::new(&Device::flex());
    assert!(guard.look(1, 4, &number(0.5), &gradients(2.0)).unwrap().is_none());
    let fault = guard.look(2, 5, &number(0.5), &gradients(f32::NAN)).expect_err("not finite");
    assert_eq!(fault, Fault { step: 2, view: 5, what: "the gradient of `logit_opacities`".into() });
    let both = guard.look(3, 0, &number(f32::INFINITY), &gradients(f32::NAN)).expect_err("not finite");
    assert_eq!(both.what, "the loss");
}

#[test]
fn a_verdict_on_the_device_holds_back_that_step_and_all_after_it() {
    let mut guard = waiting();
    let mut held = |step: usize, loss: f32, logit: f32| {
        let held = guard.look(step, 10 * step, &number(loss), &gradients(logit)).unwrap().expect("on the device");
        held.narrow(0, 0, 1).into_scalar::<i32>() != 0
    };
    assert_eq!([held(1, 0.5, 1.0), held(2, 0.4, f32::INFINITY), held(3, 0.3, 1.0)], [false, true, true]);
    // Later steps do not change the verdict.
    assert!(held(4, f32::NAN, f32::NAN));
    let fault = guard.read(true).expect_err("not finite");
    assert_eq!(fault, Fault { step: 2, view: 20, what: "the gradient of `logit_opacities`".into() });
}

#[test]
fn the_verdict_is_read_when_asked_for_and_at_the_latest_every_fifty_steps() {
    let mut guard = waiting();
    let look = |guard: &mut Guard, step: usize, loss: f32| guard.look(step, 0, &number(loss), &gradients(0.0));
    for step in 1..=20 {
        look(&mut guard, step, 1.0).unwrap();
        guard.read(step % 7 == 0).unwrap();
    }
    look(&mut guard, 21, f32::NAN).unwrap();
    let mut last = 21;
    while guard.read(false).is_ok() {
        last += 1;
        look(&mut guard, last, 1.0).unwrap();
    }
    assert_eq!(last - 14, READ_EVERY);
}

/// A run of twelve steps with all events, and a loss that becomes invalid at one of them.
fn run(bad_step: usize, spoil: fn(&LossInputs) -> Tensor<1>) -> (TrainError, GaussianRows, GaussianRows) {
    let density = AdaptiveConfig { every: 3, from: 3, until_share: 0.9, grad_threshold: 1e-5, ..Default::default() };
    let config = TrainConfig { steps: 12, sh_every: 2, density: density.into(), ..TrainConfig::default() };
    let trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
    let mut trainer = trainer.with_loss(move |seen: &LossInputs| {
        let loss = photometric(seen.image.clone(), seen.truth, DEFAULT_LAMBDA);
        if seen.step == bad_step { loss + spoil(seen) } else { loss }
    });
    for _ in 1..bad_step {
        trainer.step().unwrap();
    }
    // The degree of the harmonics rises before the step, which changes no picture.
    trainer.scene.grow_sh(super::super::sh_degree_at(bad_step - 1, 2, 3));
    let before = trainer.gaussians().to_rows();
    let error = trainer.step().expect_err("not finite");
    (error, before, trainer.gaussians().to_rows())
}

/// A function with the value 0 and the derivative 0 · ∞.
fn root_of_zero(of: Tensor<1>) -> Tensor<1> {
    (of * 0.0).sqrt()
}

#[test]
fn a_step_that_is_not_finite_changes_nothing_and_is_named() {
    type Spoil = fn(&LossInputs) -> Tensor<1>;
    let cases: [(usize, Spoil, &str); 4] = [
        (1, |seen| seen.image.clone().mean() * f32::NAN, "the loss"),
        (7, |seen| seen.image.clone().mean() * f32::INFINITY, "the loss"),
        (5, |seen| root_of_zero(seen.input.splats.scales.clone().sum()), "the gradient of `log_scales`"),
        (8, |seen| root_of_zero(seen.image.clone().sum()), "`means`, `rotations`, `log_scales`, `logit_opacities`"),
    ];
    for (bad_step, spoil, what) in cases {
        let (error, before, after) = run(bad_step, spoil);
        assert!(error.keeps_scene());
        let message = error.to_string();
        let TrainError::NonFinite { step, view, .. } = error else { panic!("{message}") };
        assert_eq!(step, bad_step);
        assert!(["a", "b", "c", "d"].contains(&view.as_str()));
        for part in
            [what, &format!("step {step}"), &format!("photograph `{view}`"), "every stage of the render is finite"]
        {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
        assert_eq!(after, before, "the scene changed");
        assert_eq!(after.unusable(), 0);
    }
}

/// A render that goes wrong is named by its stage, with the scene as it was before the step.
#[test]
fn the_stage_that_goes_wrong_first_is_named() {
    let config = TrainConfig { steps: 5, background: [0.0, f32::NAN, 0.0], ..TrainConfig::default() };
    let mut trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
    let before = trainer.gaussians().to_rows();
    let message = trainer.step().expect_err("not finite").to_string();
    for part in ["step 1", "the loss", "the stage `rasterize` is the first to go wrong", "`colour` of pixel", "NaN"] {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
    assert_eq!(trainer.gaussians().to_rows(), before);
}

#[test]
fn further_blocks_of_coefficients_are_looked_at_too() {
    let blocks = |values: [f32; 2]| {
        let block = |value: f32| Some(Tensor::full([2, 3], value, &Device::flex()));
        let blocks = [1.0, values[0], values[1]].map(block).to_vec();
        Gradients(vec![GroupGradients { name: "sh".into(), blocks }])
    };
    let expected = |step| Fault { step, view: 3, what: "the gradient of `sh`".into() };
    for (step, values) in [[f32::NAN, 1.0], [1.0, f32::INFINITY], [f32::NAN, f32::NAN]].into_iter().enumerate() {
        let step = step + 1;
        let fault = Guard::new(&Device::flex()).look(step, 3, &number(0.5), &blocks(values)).expect_err("not finite");
        assert_eq!(fault, expected(step));
        let mut guard = waiting();
        guard.look(step, 3, &number(0.5), &blocks(values)).unwrap();
        assert_eq!(guard.read(true).expect_err("not finite"), expected(step));
    }
}
