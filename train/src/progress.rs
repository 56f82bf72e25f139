//! Progress of a run: for people on standard error, as a bar on a terminal and as plain lines elsewhere; for programs
//! on standard output.

use std::io::{IsTerminal, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

/// Interval between plain lines, long enough that the log of an hour stays readable.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// Interval between updates of the bar.
const BETWEEN_FRAMES: Duration = Duration::from_millis(200);

/// Weight of the newest step in the running mean of the time per step. A scene grows while it trains, so the mean over
/// the whole run would predict too early an end.
const NEWEST_WEIGHT: f64 = 0.02;

/// Options for the amount of output.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct VoiceArgs {
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
    /// Print a line of JSON to standard output for every interval and evaluation, and one with the metrics at the end,
    /// instead of text (see docs/COMMAND_LINE.md); with --quiet, print nothing else
    #[arg(long)]
    pub json: bool,
}

/// Applies to the whole process: output comes from everywhere.
static QUIET: AtomicBool = AtomicBool::new(false);
static JSON: AtomicBool = AtomicBool::new(false);

impl VoiceArgs {
    /// Applies the options from now on.
    pub fn apply(self) {
        QUIET.store(self.quiet, Ordering::Relaxed);
        JSON.store(self.json, Ordering::Relaxed);
    }
}

fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Writes a line to standard error, unless the process is quiet. A closed pipe is not an error.
pub fn note(line: &str) {
    if !is_quiet() {
        error(line);
    }
}

/// Writes a line to standard error, even if the process is quiet.
pub fn error(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Prints a note if some Gaussians of a scene are left out.
pub fn note_unusable(scene: &Path, unusable: usize, of: usize) {
    if unusable > 0 {
        note(&format!(
            "{}: {unusable} of {of} splats are not drawn, because a parameter is not finite or out of range, or the \
             rotation is zero",
            scene.display()
        ));
    }
}

/// Writes a line to standard output, unless the process is quiet or prints JSON. A closed pipe loses no results, which
/// are in their files by then.
pub fn say(line: &str) {
    if !is_quiet() && !JSON.load(Ordering::Relaxed) {
        let _ = writeln!(std::io::stdout().lock(), "{line}");
    }
}

/// Writes a value as a line of JSON to standard output and flushes it, if the process prints JSON.
pub fn line(value: &impl Serialize) {
    if JSON.load(Ordering::Relaxed)
        && let Ok(text) = serde_json::to_string(value)
    {
        let mut out = std::io::stdout().lock();
        let _ = writeln!(out, "{text}").and_then(|()| out.flush());
    }
}

/// Returns a counter of things that take a moment each, such as pictures. Hidden without a terminal.
pub fn counter(what: &'static str, total: usize) -> ProgressBar {
    if is_quiet() || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(total as u64).with_message(what);
    bar.set_style(style("{msg} [{bar:32}] {pos}/{len}"));
    bar
}

/// Returns a style, or indicatif's default if it refuses the template, for which no template here gives a reason.
fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// Progress of the steps of a training run.
pub struct StepProgress {
    steps: usize,
    bar: Option<ProgressBar>,
    shown: Instant,
    stepped: Instant,
    /// Number of steps in this process; a resumed run begins at a later step.
    counted: usize,
    /// Running mean of the time per step, s.
    step_s: f64,
    /// Sum and number of the losses since they were last shown.
    losses: (f64, usize),
}

impl StepProgress {
    /// Begins the progress of a run of `steps` steps, some of which may be done.
    pub fn new(steps: usize) -> Self {
        let shows = !is_quiet() && std::io::stderr().is_terminal();
        let bar = shows.then(|| ProgressBar::new(steps as u64));
        if let Some(bar) = &bar {
            bar.set_style(style("[{bar:32}] {msg}"));
        }
        let now = Instant::now();
        Self { steps, bar, shown: now, stepped: now, counted: 0, step_s: 0.0, losses: (0.0, 0) }
    }

    /// Counts a step; steps are numbered from 1. Returns whether it is time to [show](Self::show) progress.
    pub fn tick(&mut self, step: usize) -> bool {
        let now = Instant::now();
        let latest_s = (now - self.stepped).as_secs_f64();
        (self.stepped, self.counted) = (now, self.counted + 1);
        // The plain mean at first, so that a slow first step does not dominate the start.
        let weight = NEWEST_WEIGHT.max(1.0 / self.counted as f64);
        self.step_s += weight * (latest_s - self.step_s);
        let pause = if self.bar.is_some() { BETWEEN_FRAMES } else { BETWEEN_LINES };
        !is_quiet() && (now - self.shown >= pause || step >= self.steps)
    }

    /// Restarts the clock after other work, whose time belongs to no step.
    pub fn resume(&mut self) {
        self.stepped = Instant::now();
    }

    /// Adds the sum and the number of the losses since the last call.
    pub fn add(&mut self, (sum, count): (f64, usize)) {
        self.losses.0 += sum;
        self.losses.1 += count;
    }

    /// Shows the state of the run.
    pub fn show(&mut self, step: usize, splats: usize) {
        self.shown = Instant::now();
        let (sum, count) = std::mem::take(&mut self.losses);
        let line = progress_line(step, self.steps, sum / count as f64, splats, self.step_s);
        match &self.bar {
            None => note(&line),
            Some(bar) => {
                bar.set_position(step as u64);
                bar.set_message(line);
            }
        }
    }

    /// Removes the bar after the last step.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.abandon();
        }
    }
}

fn progress_line(step: usize, steps: usize, loss: f64, splats: usize, step_s: f64) -> String {
    let rate = if step_s > 0.0 { format!("{:.1}", 1.0 / step_s) } else { "-".into() };
    let left = clock(step_s * (steps.saturating_sub(step)) as f64);
    format!("step {step}/{steps}  loss {loss:.4}  {splats} splats  {rate} steps/s  {left} left")
}

/// Formats seconds as `m:ss` or `h:mm:ss`.
fn clock(seconds: f64) -> String {
    // Saturates: no run is that long, and NaN becomes zero.
    let whole = seconds.round() as u64;
    let (hours, minutes, seconds) = (whole / 3600, whole / 60 % 60, whole % 60);
    if hours > 0 { format!("{hours}:{minutes:02}:{seconds:02}") } else { format!("{minutes}:{seconds:02}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_all() {
        let expected = "step 240/2000  loss 0.0412  12345 splats  8.0 steps/s  3:40 left";
        assert_eq!(progress_line(240, 2000, 0.04123, 12_345, 0.125), expected);
    }

    #[test]
    fn clocks() {
        assert_eq!(clock(0.4), "0:00");
        assert_eq!(clock(59.6), "1:00");
        assert_eq!(clock(3_725.0), "1:02:05");
        assert_eq!(clock(f64::NAN), "0:00");
    }
}
