//! Progress of a run: for people on standard error, as a bar on a terminal and as plain lines elsewhere; for programs on standard output.

use std::io::{IsTerminal, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

/// Interval between plain lines, long enough that the log of an hour stays readable.
pub(crate) const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// Interval between updates of the bar.
pub(crate) const BETWEEN_FRAMES: Duration = Duration::from_millis(200);

/// Number after which the mean time of one tells how long the others take.
const EXPECTED_FROM: usize = 5;

/// Options for the amount of output.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct VoiceArgs {
    /// Print nothing but errors
    #[arg(long)]
    pub quiet: bool,
    /// Print a line of JSON to standard output for every interval and evaluation, and one with the metrics at the end,
    /// instead of text (see docs/COMMAND_LINE.md); with --quiet, print nothing else
    #[arg(long, help_heading = "Output")]
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

pub(crate) fn is_quiet() -> bool {
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

/// Returns a counter of things that take a moment each, such as pictures. It disappears when it is dropped, and is hidden without a terminal.
pub fn counter(what: &'static str, total: usize) -> ProgressBar {
    let bar = bar(Some(total), "{msg} [{bar:32}] {pos}/{len}");
    bar.map_or_else(ProgressBar::hidden, |bar| bar.with_message(what))
}

/// Returns a bar, unless the process is quiet or has no terminal.
pub(crate) fn bar(total: Option<usize>, template: &str) -> Option<ProgressBar> {
    if is_quiet() || !std::io::stderr().is_terminal() {
        return None;
    }
    let bar = total.map_or_else(ProgressBar::no_length, |total| ProgressBar::new(total as u64));
    // indicatif refuses none of these templates.
    Some(bar.with_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())))
}

/// Progress of a program that counts what it has done: a bar on a terminal, a line now and then elsewhere.
pub struct CountedProgress {
    what: &'static str,
    bar: Option<ProgressBar>,
    started: Instant,
    shown: Instant,
    /// Number done, of how many if that is known.
    done: (usize, Option<usize>),
}

impl CountedProgress {
    /// Begins with nothing done.
    pub fn new(what: &'static str) -> Self {
        let bar = bar(None, "{prefix} [{bar:32}] {pos}/{len}  {elapsed}{msg}");
        if let Some(bar) = &bar {
            bar.set_prefix(what);
            bar.enable_steady_tick(BETWEEN_FRAMES);
        }
        let now = Instant::now();
        Self { what, bar, started: now, shown: now, done: (0, None) }
    }

    /// What is left, from the mean of those that are done, or nothing.
    fn said_left(&self) -> String {
        let (done, total) = self.done;
        left(done, total.unwrap_or(0), self.started.elapsed().as_secs_f64())
    }

    /// Shows the number done, of how many if that is known.
    pub fn set(&mut self, done: usize, total: Option<usize>) {
        self.done = (done, total);
        if let (Some(bar), Some(total)) = (&self.bar, total) {
            bar.set_length(total as u64);
        }
        match &self.bar {
            Some(bar) => {
                bar.set_position(done as u64);
                bar.set_message(self.said_left());
            }
            None if self.shown.elapsed() >= BETWEEN_LINES => {
                self.shown = Instant::now();
                let of = self.done.1.map(|total| format!(" of {total}")).unwrap_or_default();
                note(&format!("{}: {done}{of}{}", self.what, self.said_left()));
            }
            None => {}
        }
    }

    /// Removes the bar, and says how long it took.
    pub fn finish(self) {
        drop(self.bar);
        note(&format!("{}: {} done in {}", self.what, self.done.0, clock(self.started.elapsed().as_secs_f64())));
    }
}

/// The time that is left after `done` of `total` in `seconds`; nothing before [`EXPECTED_FROM`] and after the last.
fn left(done: usize, total: usize, seconds: f64) -> String {
    if !(EXPECTED_FROM..total).contains(&done) {
        return String::new();
    }
    format!(", {} left", clock(seconds / done as f64 * (total - done) as f64))
}

/// Formats seconds as `m:ss` or `h:mm:ss`.
pub(crate) fn clock(seconds: f64) -> String {
    // Saturates: no run is that long, and NaN becomes zero.
    let whole = seconds.round() as u64;
    let (hours, minutes, seconds) = (whole / 3600, whole / 60 % 60, whole % 60);
    if hours > 0 { format!("{hours}:{minutes:02}:{seconds:02}") } else { format!("{minutes}:{seconds:02}") }
}

#[cfg(test)]
mod tests;
