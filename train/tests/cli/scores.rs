//! Scores during a run.

use std::fs;
use std::path::Path;

use clap::Parser;
use rand::Rng;
use serde_json::Value;
use splat_model::density::rows::{RowEdit, Trained};
use splat_model::density::{RefineReport, Refined, Strategy, StrategyContext, rows_on};
use splat_train::options::{Cli, Command};
use splat_train::train;

use crate::run::{DEMO, TRAIN, refuse, splat, succeed};
use crate::text;

#[test]
fn scores_during_a_run_change_nothing_about_it() {
    let scene = |more: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        succeed(splat(&TRAIN).arg(DEMO.as_path()).args(["--quiet", "--out", text(folder.path())]).args(more));
        fs::read(folder.path().join("scene.ply")).unwrap()
    };
    assert!(scene(&[]) == scene(&["--eval-during", "5"]), "another scene");
}

#[test]
fn scores_during_a_run_need_test_views() {
    let folder = tempfile::tempdir().unwrap();
    let run = ["--eval-during", "5", "--test-every", "0", "--out", text(folder.path())];
    refuse(splat(&TRAIN).arg(DEMO.as_path()).args(run), &["--eval-during", "--test-every"]);
    let run = ["--eval-during", "0", "--test-every", "0", "--out", text(folder.path())];
    succeed(splat(&TRAIN).arg(DEMO.as_path()).args(run));
}

/// Removes every second Gaussian at a step, or never.
struct Halve {
    at: Option<usize>,
}

impl Strategy for Halve {
    fn acts_at(&self, step: usize) -> bool {
        self.at == Some(step)
    }

    fn act(&mut self, scene: &mut Trained, at: &StrategyContext, _: &mut dyn Rng) -> Refined {
        if !self.acts_at(at.step) {
            return Ok(None);
        }
        let count = scene.gaussians.len();
        let keep: Vec<u32> = (0..count as u32).step_by(2).collect();
        let pruned = count - keep.len();
        let device = scene.gaussians.means().device().inner();
        scene.edit(&RowEdit::new(rows_on(&device, &keep), rows_on(&device, &[])))?;
        Ok(Some(RefineReport { pruned, ..RefineReport::default() }))
    }
}

/// The history in a run's report.
fn history(out: &Path) -> Value {
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    let data = page.split_once("id=\"history\">").unwrap().1.split_once("</script>").unwrap().0;
    serde_json::from_str::<Value>(data).unwrap()[0].clone()
}

#[test]
fn scores_that_a_run_takes_by_itself_take_a_fiftieth_of_its_time() {
    let folder = tempfile::tempdir().unwrap();
    succeed(splat(&TRAIN).arg(DEMO.as_path()).args(["--steps", "600", "--out", text(folder.path())]));
    let metrics: Value = serde_json::from_slice(&fs::read(folder.path().join("metrics.json")).unwrap()).unwrap();
    let [train, scores] = ["train", "scores"].map(|part| metrics["seconds"][part].as_f64().unwrap());
    let count = history(folder.path())["scores"].as_array().unwrap().len();
    assert!((1..=10).contains(&count), "{count} scores");
    // The last may take longer than those before it, by which its time was predicted.
    assert!(scores - 2.0 * scores / count as f64 <= 0.02 * train, "{count} scores took {scores} s of {train} s");
}

/// Trains within this process and returns the steps, scores and sizes of the scene after 4, 8, 12 and 16 steps.
fn scores_with(strategy: Halve, out: &Path) -> Vec<[Value; 3]> {
    let run = ["--eval-during", "4", "--device", "cpu", "--out", text(out)];
    let arguments = [&["splat"], &TRAIN[..], &[text(&DEMO)], &run].concat();
    let Command::Train(args) = Cli::try_parse_from(arguments).unwrap().command else { panic!("asked for train") };
    train::run_with(&args, |trainer| trainer.with_strategy(strategy).unwrap()).unwrap();
    let history = history(out);
    // The number of splats is that before the step's refinement too: of the step before it.
    let splats = |step: &Value| history["points"][step.as_u64().unwrap() as usize - 2]["splats"].clone();
    let scores = history["scores"].as_array().unwrap().iter();
    scores.map(|score| [score["step"].clone(), score["psnr"].clone(), splats(&score["step"])]).collect()
}

#[test]
fn a_score_shows_the_scene_before_the_refinement_of_its_step() {
    let folder = tempfile::tempdir().unwrap();
    let plain = scores_with(Halve { at: None }, &folder.path().join("plain"));
    let halved = scores_with(Halve { at: Some(8) }, &folder.path().join("halved"));
    assert_eq!(plain.iter().map(|score| &score[0]).collect::<Vec<_>>(), [4, 8, 12, 16]);
    assert_eq!(halved[..2], plain[..2]);
    // The refinement is not skipped.
    let count = |score: &[Value; 3]| score[2].as_u64().unwrap();
    assert_eq!(count(&halved[2]), count(&plain[2]).div_ceil(2));
}
