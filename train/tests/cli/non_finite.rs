//! Runs and scenes with values that are not finite.

use std::path::Path;

use burn::tensor::Tensor;
use clap::Parser;
use splat_model::gaussians::GaussianRows;
use splat_model::ply;
use splat_model::trainer::LossInputs;
use splat_train::options::{Cli, Command};
use splat_train::train;

use crate::run::{DEMO, TRAIN, TRAINED, end, refuse, splat};
use crate::{json, text};

/// Whether a photograph of the demo capture is trained on.
fn is_training_view(name: &str) -> bool {
    (1..8).any(|view| name == format!("{view:04}.png"))
}

/// Returns the photograph that a message names.
fn named_view(message: &str) -> &str {
    message.split('`').find(|part| part.ends_with(".png")).unwrap_or_else(|| panic!("no photograph: {message}"))
}

/// Trains within this process, with a loss that fails, and returns the message.
fn train_with(loss: impl Fn(&LossInputs) -> Tensor<1> + 'static, options: &[&str], out: &Path) -> String {
    let arguments = [&["splat"], &TRAIN[..], &[text(&DEMO), "--device", "cpu", "--out", text(out)], options].concat();
    let Command::Train(args) = Cli::try_parse_from(arguments).unwrap().command else { panic!("asked for train") };
    let error = train::run_with(&args, |trainer| trainer.with_loss(loss)).expect_err("not finite");
    splat_train::describe(&error)
}

/// Returns the mean of the picture, plus at one step the square root of 0 times it: a finite value without a finite
/// gradient.
fn spoilt_gradient(at: usize) -> impl Fn(&LossInputs) -> Tensor<1> {
    move |seen| {
        let mean = seen.image.clone().mean();
        if seen.step == at { mean.clone() + (mean * 0.0).sqrt() } else { mean }
    }
}

#[test]
fn a_gradient_that_is_not_finite_ends_the_run_and_keeps_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    // The scene before the step, from a run that fails one step later.
    let [rows, later] = [6, 7].map(|step| {
        let out = folder.path().join(step.to_string());
        let message = train_with(spoilt_gradient(step), &[], &out);
        let view = named_view(&message);
        assert!(is_training_view(view), "{message}");
        let scene = out.join("scene.ply");
        let parts =
            ["error: ", &format!("step {step}"), "gradient of `means`, `rotations`", "render is finite", text(&scene)];
        parts.iter().for_each(|part| assert!(message.contains(part), "{part:?} is not in: {message}"));
        assert!(!out.join("metrics.json").exists(), "there is nothing to measure");
        ply::read(&scene).unwrap().0
    });
    assert_eq!((rows.unusable(), later.unusable()), (0, 0));
    assert_ne!(rows, later, "one step lies between them");
}

#[test]
fn a_loss_that_is_not_finite_ends_the_run() {
    let out = tempfile::tempdir().unwrap();
    let message = train_with(|seen| seen.image.clone().mean() * f32::INFINITY, &[], out.path());
    for part in ["step 1", "the loss is not finite", text(&out.path().join("scene.ply"))] {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
    assert_eq!(ply::read(&out.path().join("scene.ply")).unwrap().0.unusable(), 0);
}

/// The program itself fails on a weight that f32 cannot hold, because it makes the loss infinite.
#[test]
fn the_program_says_which_step_and_view() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let arguments = ["--opacity-weight", "1e300", "--out", text(&out)];
    let scene = out.join("scene.ply");
    let mut command = splat(&TRAIN);
    command.arg(DEMO.as_path()).args(arguments);
    refuse(
        &mut command,
        &["step 1", "photograph `000", "the loss is not finite", "every stage of the render is finite", text(&scene)],
    );
    assert!(ply::read(&scene).unwrap().0.len() > 100);
}

/// Returns the trained scene with some Gaussians poisoned, and their number.
fn poisoned() -> (GaussianRows, usize) {
    let (mut rows, _) = ply::read(&TRAINED.join("scene.ply")).unwrap();
    rows.means[0][1] = f32::NAN;
    rows.log_scales[1] = [f32::INFINITY; 3];
    rows.rotations[2] = [0.0; 4];
    rows.logit_opacities[3] = f32::NAN;
    rows.sh_dc[4][2] = f32::NAN;
    rows.sh_dc[5][0] = f32::MAX;
    (rows, 6)
}

#[test]
fn poisoned_splats_of_a_scene_are_counted_and_change_no_score() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, count) = poisoned();
    let mut without = rows.clone();
    // Too faint to change a picture by one thousandth of a level.
    without.logit_opacities[..count].fill(-200.0);
    for (values, fill) in
        [(&mut without.means, [0.0; 3]), (&mut without.log_scales, [-3.0; 3]), (&mut without.sh_dc, [0.0; 3])]
    {
        values[..count].fill(fill);
    }
    without.rotations[..count].fill([1.0, 0.0, 0.0, 0.0]);
    let [poisoned, without] = [("poisoned", &rows), ("without", &without)].map(|(name, rows)| {
        let (scene, out) = (folder.path().join(format!("{name}.ply")), folder.path().join(name));
        ply::write(&scene, rows, ply::WorldFrame::default()).unwrap();
        let ended = end(&mut splat(&["eval", text(&DEMO), "--scene", text(&scene), "--out", text(&out)]));
        assert_eq!(ended.code, Some(0), "{}", ended.stderr);
        let said = ended.stderr.contains(&format!("{count} of {} splats are not drawn", rows.len()));
        assert_eq!(said, name == "poisoned", "{}", ended.stderr);
        json(&out.join("metrics.json"))
    });
    assert_eq!([&poisoned["culled_non_finite"], &without["culled_non_finite"]], [count, 0]);
    assert_eq!(poisoned["test"], without["test"]);
}
