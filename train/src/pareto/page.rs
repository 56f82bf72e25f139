//! `pareto.md`: the tables.

use std::fmt::Write;

use splat_model::accuracy::{DIALS, Dial, Judge, Preset};
use splat_op::RenderOptions;

use super::dials::Role;
use super::measure::{BenchOutcome, Isolated, SettingMeasurements};
use super::quartiles::{Quartiles, decibels};
use super::training::TrainingResult;

/// Quartiles of fewer rounds than this are unreliable.
const FEW_ROUNDS: usize = 8;

/// Subject of a page.
pub struct PageSubject<'a> {
    pub capture: String,
    pub scene: String,
    pub device: &'a str,
    pub splats: usize,
    /// Names of the views, and their size.
    pub views: Vec<String>,
    pub size: (usize, usize),
    pub base: RenderOptions,
}

/// Returns the page. `members` are the rows on the frontiers of renders and of training steps; `more` are the sections after
/// the dials.
pub fn page(subject: &PageSubject, outcome: &BenchOutcome, members: [&[usize]; 2], more: &[&str]) -> String {
    let mut text = intro(subject, outcome);
    text.push_str(&frontiers(outcome, members));
    text.push_str("\n## Presets and combinations\n\n");
    let several = |row: &&SettingMeasurements| !matches!(row.candidate.role, Role::Dial(_));
    text.push_str(&table(outcome, outcome.rows.iter().filter(several).map(|row| (row.candidate.name.clone(), row))));
    text.push_str("\nWhat they turn:\n\n");
    for row in outcome.rows.iter().filter(several) {
        _ = writeln!(text, "- {}: {}", row.candidate.name, row.candidate.setting);
    }
    text.push_str("\n## Numerical dials\n\nJudged against the exact render under the same model choices.\n");
    for dial in measured_dials(outcome, Judge::Exact) {
        _ = write!(text, "\n### `{}`: {}\n\n", dial.name, dial.what);
        text.push_str(&table(outcome, values(dial, subject, outcome)));
        text.push_str(&alone(dial, outcome));
    }
    text.push_str(
        "\n## Model choices\n\nThey define another function, so photographs judge them. This scene was trained under its own \
         choices and fits those best; what another choice would do for a scene that is trained with it is another question.\n",
    );
    for dial in measured_dials(outcome, Judge::Photographs) {
        _ = write!(text, "\n### `{}`: {}\n\n", dial.name, dial.what);
        text.push_str(&table(outcome, values(dial, subject, outcome)));
    }
    text + &more.concat()
}

fn intro(subject: &PageSubject, outcome: &BenchOutcome) -> String {
    let PageSubject { capture, scene, device, splats, views, size: (width, height), .. } = subject;
    let (rounds, reference, names) = (outcome.rounds, outcome.reference, views.join(", "));
    let few = match rounds < FEW_ROUNDS {
        true => " **That is few**: before believing small differences, measure for longer (`--budget`).",
        false => "",
    };
    format!(
        "# What accuracy costs in time\n\n\
         `{scene}` ({splats} splats) on {device}, seen by {} views of `{capture}` ({names}) at up to {width} × {height} px. \
         Written by `splat pareto`, which measured every setting {rounds} times, in turns.{few}\n\n\
         ![Time of a frame against error](pareto.svg)\n\n\
         Errors are against a render of the whole picture in float64 without any approximation, which in pixels all over the views \
         differed by at most {reference:.0e} from a renderer that visits every Gaussian in every pixel. *Error* is the PSNR of the pictures \
         against it, in dB, and *max* the largest error of a pixel's channel, of colours in 0..1. Gradients are those of L1 + \
         D-SSIM at the exact picture, of the parameter that fares worst. Times are medians with their quartiles, ms a frame; \
         settings whose quartiles overlap are *not told apart*, and not ranked. Memory is the most that a render with its \
         backward pass holds.\n",
        views.len()
    )
}

/// Returns the names of the settings that no other beats in both time and error.
fn frontiers(outcome: &BenchOutcome, members: [&[usize]; 2]) -> String {
    let mut text = String::new();
    for (members, what) in members.into_iter().zip(["renders", "training steps"]) {
        let names: Vec<&str> = members.iter().map(|&i| outcome.rows[i].candidate.name.as_str()).collect();
        _ = write!(text, "\nThe frontier of {what}, from accurate to fast: {}.\n", names.join(", "));
    }
    text
}

fn measured_dials(outcome: &BenchOutcome, judge: Judge) -> impl Iterator<Item = &'static Dial> {
    let measured = |dial: &&Dial| outcome.rows.iter().any(|row| row.candidate.role == Role::Dial(dial.name));
    DIALS.iter().filter(move |dial| dial.judge == judge).filter(measured)
}

/// The values of a dial in the table's order, with their rows. The base's own value has the row of the base.
fn values<'a>(
    dial: &'static Dial,
    subject: &'a PageSubject,
    outcome: &'a BenchOutcome,
) -> impl Iterator<Item = (String, &'a SettingMeasurements)> {
    dial.values.iter().filter_map(move |value| {
        let options = (value.set)(subject.base);
        Some((value.name.to_owned(), outcome.rows.iter().find(|row| row.candidate.options == options)?))
    })
}

/// Table of the errors of a dial's values in isolation.
fn alone(dial: &Dial, outcome: &BenchOutcome) -> String {
    let mut text = String::from(
        "\nAlone, with every other numerical dial at its most accurate:\n\n\
         | setting | error, dB | max | gradient error | cosine |\n|---|---|---|---|---|\n",
    );
    for Isolated { value, accuracy: a, .. } in outcome.alone.iter().filter(|alone| alone.dial == dial.name) {
        let (db, max, error, worst) = (decibels(a.rms), a.max, a.gradient_error, a.worst);
        _ = writeln!(text, "| {value} | {db:.1} | {max:.1e} | {error:.1e} ({worst}) | {:.6} |", a.gradient_cosine);
    }
    text
}

fn table<'a>(outcome: &'a BenchOutcome, rows: impl Iterator<Item = (String, &'a SettingMeasurements)>) -> String {
    let mut text = String::from(
        "| setting | error, dB | max | PSNR, dB | SSIM | forward, ms | backward, ms | memory, MiB | gradient error | cosine | \
         a frame, to the standard |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let standard = outcome.rows.iter().find(|row| row.candidate.name == Preset::Standard.name());
    let or_none = |found: Option<String>| found.unwrap_or_else(|| "–".into());
    for (name, row) in rows {
        let accuracy = row.accuracy.as_ref();
        let scores = row.scores.map(|(psnr, ssim)| {
            let change = standard.and_then(|standard| standard.scores).map_or(0.0, |(theirs, _)| psnr - theirs);
            (format!("{psnr:.2} ({change:+.2})"), format!("{ssim:.4}"))
        });
        let (psnr, ssim) = scores.unzip();
        let cells = [
            name,
            or_none(row.error_db().map(|db| format!("{db:.1}"))),
            or_none(accuracy.map(|a| format!("{:.1e}", a.max))),
            or_none(psnr),
            or_none(ssim),
            times(&row.times.forward),
            times(&row.times.backward),
            or_none(row.memory_mib.map(|mib| format!("{mib:.1}"))),
            or_none(accuracy.map(|a| format!("{:.1e} ({})", a.gradient_error, a.worst))),
            or_none(accuracy.map(|a| format!("{:.6}", a.gradient_cosine))),
            or_none(standard.map(|standard| pace(&row.times.forward, &standard.times.forward))),
        ];
        _ = writeln!(text, "| {} |", cells.join(" | "));
    }
    text
}

fn times(spread: &Quartiles) -> String {
    format!("{:.2} ({:.2}–{:.2})", spread.median, spread.lower, spread.upper)
}

/// Formats a time relative to another.
fn pace(ours: &Quartiles, theirs: &Quartiles) -> String {
    match () {
        () if ours == theirs => "itself".into(),
        () if ours.overlaps(theirs) => "not told apart".into(),
        () => format!("{:+.0}%", 100.0 * (ours.median / theirs.median - 1.0)),
    }
}

/// Returns the section on training dials; nothing without runs.
pub fn training(trained: &[TrainingResult]) -> String {
    let Some(standard) = trained.first() else { return String::new() };
    let mut text = String::from(
        "\n## Training dials\n\n![Seconds of training against PSNR](pareto_train.svg)\n\nShort runs, with three seeds each, scored on \
         the test photographs with the standard render. Where quartiles overlap, the two ways are not ranked.\n\n\
         | way | options | PSNR, dB | to the standard | training, s | to the standard | splats |\n|---|---|---|---|---|---|---|\n",
    );
    for run in trained {
        let gained = match () {
            () if run.name == standard.name => "itself".into(),
            () if run.psnr.overlaps(&standard.psnr) => "not told apart".into(),
            () => format!("{:+.2} dB", run.psnr.median - standard.psnr.median),
        };
        let flags = if run.flags.is_empty() { "–".into() } else { format!("`{}`", run.flags) };
        let (psnr, seconds) = (times(&run.psnr), times(&run.seconds));
        let pace = pace(&run.seconds, &standard.seconds);
        _ = writeln!(text, "| {} | {flags} | {psnr} | {gained} | {seconds} | {pace} | {} |", run.name, run.splats);
    }
    text
}
