//! What a waiting person sees, on standard error: a bar on a terminal, plain lines elsewhere.

use std::io::{IsTerminal, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use burn::tensor::Tensor;
use indicatif::{ProgressBar, ProgressStyle};
use splat_model::trainer::StepReport;

/// Time between plain lines: a log of an hour stays readable.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// Time between updates of the bar.
const BETWEEN_FRAMES: Duration = Duration::from_millis(200);

/// Weight of the newest step in the running mean of the time that a step takes. A scene grows while it trains, so the
/// mean over the whole run would promise too early an end.
const NEWEST_WEIGHT: f64 = 0.02;

/// Writes a line to standard error. A closed pipe is no reason to stop.
pub fn note(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Says that some Gaussians of a scene are left out, if there are such.
pub fn note_unusable(scene: &Path, unusable: usize, of: usize) {
    if unusable > 0 {
        note(&format!(
            "{}: {unusable} of {of} splats are not drawn, because a parameter is not finite or out of all range, or the \
             rotation is zero",
            scene.display()
        ));
    }
}

/// Writes a line to standard output. The results are in their files by then, so a closed pipe loses none.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{line}");
}

/// Counts things that take a moment each, such as pictures. Silent where there is no terminal.
pub fn counter(what: &'static str, total: usize) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(total as u64).with_message(what);
    bar.set_style(style("{msg} [{bar:32}] {pos}/{len}"));
    bar
}

/// A style, or indicatif's own if it refuses the template, which none here gives it reason to.
fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// Progress of the steps of a training run.
pub struct StepProgress {
    steps: usize,
    bar: Option<ProgressBar>,
    shown: Instant,
    stepped: Instant,
    /// Since this began.
    seen: usize,
    /// Running mean of the time that a step takes, s.
    step_s: f64,
    /// `[1]`: sum of the losses since they were last shown, and how many. Kept on the device: reading each would wait.
    losses: Option<(Tensor<1>, usize)>,
}

impl StepProgress {
    /// Of a run of `steps` steps, some of which may be done.
    pub fn new(steps: usize) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| ProgressBar::new(steps as u64));
        if let Some(bar) = &bar {
            bar.set_style(style("[{bar:32}] {msg}"));
        }
        let now = Instant::now();
        Self { steps, bar, shown: now, stepped: now, seen: 0, step_s: 0.0, losses: None }
    }

    /// After a step.
    pub fn step(&mut self, report: &StepReport) {
        let now = Instant::now();
        let latest_s = (now - self.stepped).as_secs_f64();
        self.stepped = now;
        // The plain mean at first, lest a slow first step colour the whole start.
        self.seen += 1;
        let weight = NEWEST_WEIGHT.max(1.0 / self.seen as f64);
        self.step_s += weight * (latest_s - self.step_s);
        self.losses = Some(match self.losses.take() {
            Some((sum, count)) => (sum + report.loss.clone(), count + 1),
            None => (report.loss.clone(), 1),
        });
        let pause = if self.bar.is_some() { BETWEEN_FRAMES } else { BETWEEN_LINES };
        if now - self.shown < pause && report.step < self.steps {
            return;
        }
        self.shown = now;
        let loss = self.losses.take().map_or(f64::NAN, |(sum, count)| sum.into_scalar::<f64>() / count as f64);
        let line = line(report.step, self.steps, loss, report.splats, self.step_s);
        match &self.bar {
            None => note(&line),
            Some(bar) => {
                bar.set_position(report.step as u64);
                bar.set_message(line);
            }
        }
    }

    /// After the last step.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.abandon();
        }
    }
}

fn line(step: usize, steps: usize, loss: f64, splats: usize, step_s: f64) -> String {
    let rate = if step_s > 0.0 { format!("{:.1}", 1.0 / step_s) } else { "-".into() };
    let left = clock(step_s * (steps.saturating_sub(step)) as f64);
    format!("step {step}/{steps}  loss {loss:.4}  {splats} splats  {rate} steps/s  {left} left")
}

/// Seconds as `m:ss` or `h:mm:ss`.
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
        assert_eq!(line(240, 2000, 0.04123, 12_345, 0.125), expected);
    }

    #[test]
    fn clocks() {
        assert_eq!(clock(0.4), "0:00");
        assert_eq!(clock(59.6), "1:00");
        assert_eq!(clock(3_725.0), "1:02:05");
        assert_eq!(clock(f64::NAN), "0:00");
    }
}
