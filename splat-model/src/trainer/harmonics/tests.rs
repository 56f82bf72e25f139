use burn::tensor::Device;
use glam::{DAffine3, DVec3};
use splat_op::{Extras, Intrinsics, render_view};

use super::*;
use crate::gaussians::testing::random_rows;
use crate::gaussians::{GaussianRows, Gaussians, values_of};
use crate::trainer::testing::{photos, points};
use crate::trainer::{TrainConfig, Trainer};

const COUNT: usize = 30;

/// Some Gaussians, those from `directional` on without higher coefficients.
fn scene(directional: usize) -> Gaussians {
    let mut rows = random_rows(COUNT, 2, 5);
    let rest = rows.rest_per_row();
    rows.sh_rest[rest * directional..].fill(0.0);
    // Some channels are held at zero, and others are not.
    rows.sh_dc.iter_mut().step_by(3).for_each(|colour| colour[1] = -2.5);
    Gaussians::from_rows_apart(&rows, &Device::flex().autodiff()).unwrap()
}

/// The picture, and the gradients of some function of it.
fn render(gaussians: &Gaussians, holds: bool) -> (Vec<f32>, Gradients) {
    let pose = DAffine3::from_translation(DVec3::new(0.1, 0.0, 4.0));
    let camera = Camera::new(Intrinsics::centred(48, 40, 40.0), &pose, &Device::flex().autodiff());
    let (mut splats, options) = (gaussians.splats(), RenderOptions::standard());
    let held = holds.then(|| Held::new(&mut splats).unwrap());
    let coloured = held.as_ref().map(|held| held.coloured(&splats, &camera, &options).unwrap());
    let picture = render_view(coloured.as_ref().unwrap_or(&splats), &camera, &Extras::default(), &options).unwrap();
    let mut grads = picture.colour.clone().square().sum().backward();
    let mut gradients = Gradients::take(gaussians, &mut grads);
    assert_eq!(gradients.sh.is_none(), holds);
    if let Some(held) = held {
        held.take_gradients(&mut grads, &mut gradients);
    }
    (values_of(picture.colour.inner()), gradients)
}

#[track_caller]
fn same<const D: usize>(found: Tensor<D>, expected: Tensor<D>, what: &str) {
    let (found, expected) = (values_of(found), values_of(expected));
    let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
    assert!(largest > 0.0 && found.len() == expected.len(), "{what}");
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() <= 1e-5 * largest, "{what}: {found} instead of {expected}");
    }
}

/// Pictures and all gradients but those of the higher coefficients are what they are without.
#[test]
fn held_harmonics_are_seen_and_looked_past() {
    for directional in [COUNT, 12] {
        let gaussians = scene(directional);
        let ((shown, whole), (held_shown, held)) = (render(&gaussians, false), render(&gaussians, true));
        let apart = shown.iter().zip(&held_shown).fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
        assert!(apart <= 1e-6, "{apart}");
        same(held.means.unwrap(), whole.means.unwrap(), "means");
        same(held.rotations.unwrap(), whole.rotations.unwrap(), "rotations");
        same(held.logit_opacities.unwrap(), whole.logit_opacities.unwrap(), "opacities");
        let sh = held.sh.unwrap();
        assert_eq!(sh.dims(), [directional, 1, 3]);
        same(sh, whole.sh.unwrap().narrow(1, 0, 1), "degree 0");
        assert_eq!(held.sh_matte.is_some(), directional < COUNT);
        if let (Some(found), Some(expected)) = (held.sh_matte, whole.sh_matte) {
            same(found, expected, "matte");
        }
    }
}

fn run(config: TrainConfig) -> Vec<GaussianRows> {
    let mut trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
    let mut scenes = Vec::new();
    while !trainer.is_done() {
        trainer.step().unwrap();
        scenes.push(trainer.gaussians().to_rows());
    }
    scenes
}

#[test]
fn higher_coefficients_move_when_their_step_has_come() {
    let config = TrainConfig { steps: 9, sh_every: 0, sh_degree: 1, sh_rest_every: 4, ..TrainConfig::default() };
    let scenes = run(config.clone());
    for (step, pair) in (2..).zip(scenes.windows(2)) {
        let moved = pair[0].sh_rest != pair[1].sh_rest;
        assert_eq!(moved, step % 4 == 0, "step {step}");
        assert_ne!(pair[0].sh_dc, pair[1].sh_dc, "step {step}");
    }
    // Until the first of them nothing else tells the runs apart but rounding.
    let always = run(TrainConfig { sh_rest_every: 1, ..config });
    assert_ne!(always[2].sh_rest, scenes[2].sh_rest);
    let first = scenes[0].sh_dc.as_flattened().iter().zip(always[0].sh_dc.as_flattened());
    assert!(first.clone().all(|(a, b)| (a - b).abs() < 1e-4), "{first:?}");
}

#[test]
fn where_there_are_no_higher_ones_nothing_is_different() {
    let config = TrainConfig { steps: 6, sh_degree: 0, ..TrainConfig::default() };
    assert_eq!(run(TrainConfig { sh_rest_every: 4, ..config.clone() }), run(config));
}
