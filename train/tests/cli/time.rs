//! Runs with a time instead of a number of steps.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::run::{DEMO, end, fresh, refuse, splat, succeed};
use crate::{json, text};

fn training(out: &Path, time: &str) -> Command {
    let mut command = splat(&["train", "--for", time, "--max-side", "64", "--checkpoint-every", "20"]);
    command.arg(DEMO.as_path()).arg("--out").arg(out);
    command
}

/// Checks that training took the time within a tenth, and that the record names the steps that were done.
#[track_caller]
fn assert_took(out: &Path, seconds: f64) {
    let metrics = json(&out.join("metrics.json"));
    let took = metrics["seconds"]["train"].as_f64().unwrap();
    assert!((took / seconds - 1.0).abs() < 0.1, "{took} s instead of {seconds} s");
    assert_eq!(metrics["steps"], metrics["options"]["steps"]);
}

#[test]
fn a_run_takes_the_time_that_it_is_given() {
    let out = fresh("for-3s");
    let ended = succeed(training(&out, "3s").arg("--json"));
    assert_took(&out, 3.0);
    let last = ended.stdout.lines().rfind(|line| line.contains("\"progress\"")).unwrap();
    let last: serde_json::Value = serde_json::from_str(last).unwrap();
    assert_eq!(last["step"], json(&out.join("metrics.json"))["steps"]);
}

#[test]
fn a_run_that_is_resumed_takes_the_rest_of_its_time() {
    let out = fresh("for-resumed");
    let mut child = training(&out, "4s").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = || out.join("checkpoints/step-00000040.safetensors").exists();
    while !begun() {
        assert!(child.try_wait().unwrap().is_none(), "the run has ended");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    succeed(&mut splat(&["resume", text(&out)]));
    assert_took(&out, 4.0);
}

#[test]
fn a_time_that_is_shorter_than_a_step_is_one_step_or_two() {
    let out = fresh("for-1ns");
    succeed(&mut training(&out, "1ns"));
    let steps = json(&out.join("metrics.json"))["steps"].as_u64().unwrap();
    assert!((1..=2).contains(&steps), "{steps}");
}

#[test]
fn a_time_and_a_number_of_steps_are_not_both_given() {
    for more in [["--steps", "9"], ["--for", "0s"], ["--for", "60"]] {
        assert_eq!(end(splat(&["train", "--for", "3s"]).args(more)).code, Some(2), "{more:?}");
    }
    refuse(&mut splat(&["train", "no-capture", "--for", "3s"]), &["no-capture"]);
}
