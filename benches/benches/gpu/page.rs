//! Writes the page of a graphics card, `card.md`, and the same figures as `card.json`.

use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use crate::compare::TimedPass;

/// Lines of a part's output that the page shows: the last ones.
const LINES: usize = 60;

/// How a part ended.
#[derive(Clone, Debug, Serialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    Passed,
    Failed(String),
    /// Stopped at its time limit, seconds.
    Stopped(u64),
    Skipped(String),
}

/// Result of a part.
#[derive(Clone, Debug, Serialize)]
pub struct PartResult {
    pub title: String,
    pub command: String,
    pub outcome: Outcome,
    pub seconds: f64,
    /// Most memory in use on the card while it ran, MiB, of all processes; `None` where no tool tells.
    pub memory_mib: Option<u64>,
    /// Its output, standard error after standard output.
    pub output: String,
}

/// Files that parts wrote, for the page; `None` for those that are missing.
pub struct Files {
    pub times: Option<String>,
    /// Names of training runs, and their `metrics.json`.
    pub metrics: Vec<(String, String)>,
}

/// Content of `card.json`.
#[derive(Serialize)]
struct Record<'a> {
    commit: &'a str,
    parts: &'a [PartResult],
    times: &'a [TimedPass],
    /// `metrics.json` of the training runs, by their names.
    runs: Vec<(&'a str, Value)>,
}

/// Writes the page of the parts that have run to the folder `out`.
///
/// # Errors
/// If a file cannot be written, or a part wrote a file that is not JSON.
pub fn write(out: &Path, commit: &str, parts: &[PartResult], files: &Files) -> Result<(), Box<dyn Error>> {
    let times: Vec<TimedPass> = files.times.as_deref().map(serde_json::from_str).transpose()?.unwrap_or_default();
    let runs = files.metrics.iter().map(|(run, text)| Ok((run.as_str(), serde_json::from_str(text)?)));
    let runs = runs.collect::<serde_json::Result<_>>()?;
    let record = Record { commit, parts, times: &times, runs };
    let page = markdown(&record);
    fs::write(out.join("card.json"), serde_json::to_string_pretty(&record)?)?;
    fs::write(out.join("card.md"), page)?;
    Ok(())
}

/// Formats how a part ended.
pub fn outcome(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Passed => "passed".into(),
        Outcome::Failed(status) => format!("**failed**, {status}"),
        Outcome::Stopped(seconds) => format!("**stopped** after {seconds} s"),
        Outcome::Skipped(why) => format!("skipped: {why}"),
    }
}

fn markdown(record: &Record) -> String {
    let mut page = format!("# A graphics card\n\nWritten by `benches/card.sh` from commit {}.\n\n", record.commit);
    if record.times.iter().any(|pass| pass.device.contains("software")) {
        page += "**The device is a driver in software.** It shows that the kernels run, not how fast a card is.\n\n";
    }
    page += "| part | result | seconds | memory of the card, MiB |\n|---|---|---|---|\n";
    for part in record.parts {
        let memory = part.memory_mib.map_or("-".into(), |mib| mib.to_string());
        row(&mut page, &[part.title.clone(), outcome(&part.outcome), format!("{:.1}", part.seconds), memory]);
    }
    page += &passes(record.times);
    page += &training(record);
    page += "\n## Output of the parts\n";
    for part in record.parts {
        let lines: Vec<&str> = part.output.lines().collect();
        let last = lines[lines.len().saturating_sub(LINES)..].join("\n");
        // Four backticks, because an output may contain three.
        let _ = write!(page, "\n### {}\n\n`{}`\n\n````text\n{last}\n````\n", part.title, part.command);
    }
    page
}

/// Returns a table for each scene: the time of each pass on each device, and the share of the copy bandwidth that its least bytes
/// would be.
fn passes(times: &[TimedPass]) -> String {
    let mut text = String::new();
    for scene in unique(times.iter().map(|pass| &pass.scene)) {
        let of_scene: Vec<&TimedPass> = times.iter().filter(|pass| &pass.scene == scene).collect();
        let devices = unique(of_scene.iter().map(|pass| &pass.device));
        let _ = write!(
            text,
            "\n## Passes of `{scene}`\n\nMedians in ms; in parentheses the least necessary bytes at the bandwidth of a copy, as a share \
             of the time. On a GPU the kernels launched, the MiB of all buffers that they are given, and the pairs of a pixel and a \
             Gaussian that are evaluated for each that contributes.\n\n"
        );
        let head = ["pass".into()].into_iter().chain(devices.iter().map(|device| device.to_string()));
        let head: Vec<String> = head.collect();
        row(&mut text, &head);
        row(&mut text, &vec!["---".into(); head.len()]);
        for pass in unique(of_scene.iter().map(|timed| &timed.pass)) {
            let cell = |device: &&String| {
                let found = of_scene.iter().find(|timed| &timed.pass == pass && &&timed.device == device);
                found.map_or("-".into(), |timed| {
                    let share = 100.0 * timed.limit_ms / timed.median_ms;
                    let mut cell = format!("{:.3} ({share:.0}%)", timed.median_ms);
                    if timed.launches > 0 {
                        let bound = timed.bound_bytes as f64 / f64::from(1 << 20);
                        let _ = write!(cell, "; {} launches, {bound:.1} MiB", timed.launches);
                    }
                    cell
                })
            };
            let cells: Vec<String> = [pass.clone()].into_iter().chain(devices.iter().map(cell)).collect();
            row(&mut text, &cells);
        }
    }
    text
}

/// Returns the table of the training runs.
fn training(record: &Record) -> String {
    let mut text = String::new();
    for (run, metrics) in &record.runs {
        if text.is_empty() {
            text += "\n## Training\n\n| capture and device | PSNR, dB | Gaussians | seconds |\n|---|---|---|---|\n";
        }
        let number = |keys: &[&str], digits| {
            let found = keys.iter().try_fold(metrics, |value, key| value.get(key)).and_then(Value::as_f64);
            found.map_or("-".into(), |found| format!("{found:.digits$}"))
        };
        let cells =
            [(*run).to_owned(), number(&["test", "psnr"], 2), number(&["splats"], 0), number(&["seconds", "train"], 1)];
        row(&mut text, &cells);
    }
    text
}

fn row(text: &mut String, cells: &[String]) {
    let _ = writeln!(text, "| {} |", cells.join(" | "));
}

/// Returns each value once, in the order of first appearance.
fn unique<'a>(values: impl Iterator<Item = &'a String>) -> Vec<&'a String> {
    let mut found = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}
