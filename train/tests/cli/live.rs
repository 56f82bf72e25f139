//! `--live`: what a run serves while it trains, and the button that stops it.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::run::{DEMO, fresh, refuse, splat, succeed};
use crate::view::Serving;
use crate::{json, text};

/// Time after which a run is given up.
const PATIENCE: Duration = Duration::from_secs(60);

/// Starts a run that would take hours.
pub fn start(out: &Path, more: &[&str]) -> Serving {
    let mut command = splat(&["train", "--steps", "200000", "--live", "--seed", "7"]);
    command.args(more).arg(DEMO.as_path()).arg("--out").arg(out);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    let url = lines.find_map(|line| line.strip_prefix("live: ").map(String::from));
    // A closed pipe would not end the run, but its messages have to go somewhere.
    std::thread::spawn(move || lines.for_each(drop));
    Serving::of(child, &url.expect("the run ended before it served"))
}

/// Asks for the numbers until they satisfy a condition.
#[track_caller]
fn status(serving: &Serving, wanted: impl Fn(&Value) -> bool) -> Value {
    let begin = Instant::now();
    loop {
        let status: Value = serde_json::from_slice(&serving.get("/status.json")).unwrap();
        if !status.is_null() && wanted(&status) {
            return status;
        }
        assert!(begin.elapsed() < PATIENCE, "{status}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_run_is_shown_and_stopped_and_goes_on() {
    let out = fresh("live");
    let mut serving = start(&out, &[]);
    let first = status(&serving, |_| true);
    assert_eq!((&first["steps"], &first["metrics"]), (&200_000.into(), &Value::Null));
    let later = status(&serving, |status| {
        status["scene"].as_u64() > first["scene"].as_u64() && status["worst"]["psnr"].is_f64()
    });
    assert!(later["step"].as_u64() > first["step"].as_u64(), "{later}");
    assert!(later["left_s"].as_f64().unwrap() > 0.0 && later["worst"]["name"] == "0000.png", "{later}");
    assert!(serving.get("/scene.ply").starts_with(b"ply"));
    image::load_from_memory(&serving.get("/worst.jpg")).unwrap();

    let refused = serving.ask_as("POST", "/stop", "Origin: http://evil.example\r\n");
    assert!(refused.starts_with(b"HTTP/1.1 405"), "{}", String::from_utf8_lossy(&refused));
    assert!(serving.ask("POST", "/stop").starts_with(b"HTTP/1.1 200"));
    let done = status(&serving, |status| !status["metrics"].is_null());
    // The run waits until a browser that looks has its scene.
    assert!(serving.get("/scene.ply").starts_with(b"ply"));
    assert_eq!(serving.end(), Some(0));
    let metrics = json(&out.join("metrics.json"));
    assert_eq!(done["metrics"], metrics);
    assert_eq!((&done["step"], &done["splats"]), (&metrics["steps"], &metrics["splats"]));
    assert!(out.join("report.html").is_file() && out.join("scene.ply").is_file());

    let steps = metrics["steps"].as_u64().unwrap();
    let checkpoint = out.join("checkpoints").join(format!("step-{:08}.safetensors", steps - 1));
    assert!(checkpoint.is_file(), "{} is missing", checkpoint.display());
    // The run goes on with its own number of steps, until it is stopped again.
    let mut command = splat(&["resume", "--live"]);
    let mut child = command.arg(&out).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    let said: Vec<String> = lines.take_while(|line| !line.starts_with("live: ")).collect();
    assert!(said.iter().any(|line| line.ends_with(&format!("resuming from step {} of 200000", steps - 1))), "{said:?}");
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_run_at_which_nobody_looks_is_the_same_run() {
    let train = |name: &str, more: &[&str]| {
        let out = fresh(name);
        let arguments = ["train", "--steps", "40", "--max-side", "64", "--seed", "7"];
        succeed(splat(&arguments).args(more).arg(DEMO.as_path()).arg("--out").arg(&out));
        std::fs::read(out.join("scene.ply")).unwrap()
    };
    assert!(train("live-not", &[]) == train("live-unseen", &["--live"]), "the scenes differ");
}

#[test]
fn a_port_that_is_taken_is_named() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let out = fresh("live-taken");
    refuse(
        &mut splat(&["train", &format!("--live={port}"), text(&DEMO), "--out", text(&out)]),
        &[&port, "another program has it", "--live=[HOST:]PORT"],
    );
    assert!(!out.exists());
}
