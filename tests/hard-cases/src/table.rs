//! The table of the battery, the content of `HARD_CASES.md`.

use std::fmt::Write;

use crate::case::{CaseOutcome, HardCase, MeasuredDeviation, Processor, TestDevice};
use crate::judge::{CaseResult, CaseVerdict};

/// The cases of one group, each with its result.
pub struct Section {
    pub title: &'static str,
    pub rows: Vec<(HardCase, CaseResult)>,
}

/// Formats the file's text. Figures are rounded so that the text changes only when a result does.
pub fn markdown(sections: &[Section], places: &[TestDevice]) -> String {
    let mut text = String::from(HEAD);
    let rows = || sections.iter().flat_map(|section| &section.rows);
    let count = |verdict| rows().filter(|(_, row)| row.verdict() == verdict).count();
    let names: Vec<&str> = places.iter().map(|place| place.name.as_str()).collect();
    let _ = writeln!(
        text,
        "\nPaths: {}. Of {} cases {} pass, {} are loose, {} fail.",
        names.join(", "),
        rows().count(),
        count(CaseVerdict::Passed),
        count(CaseVerdict::Loose),
        count(CaseVerdict::Failed),
    );
    if !places.iter().any(|place| place.processor == Processor::Gpu) {
        text.push_str("\nThe GPU was skipped: no adapter was found, or `SPLAT_GPU=skip`.\n");
    }
    for section in sections {
        let _ = write!(text, "\n## {}\n\n{COLUMNS}", section.title);
        section.rows.iter().for_each(|(case, row)| text.push_str(&line(case, row)));
        let notes: Vec<String> = section.rows.iter().flat_map(|(case, row)| notes(case, row)).collect();
        if !notes.is_empty() {
            let _ = writeln!(text, "\n{}", notes.join("\n"));
        }
    }
    text
}

const HEAD: &str = "\
# Hard cases

Written by `splat hard-cases --out DIR`; do not edit.

These scenes make splatting lose digits, leave the range of f32 or divide by zero. Each scene is rendered and differentiated in f32
and compared with a reference: the papers' formulas in 106-bit arithmetic, forwards and backwards. The CPU twin in f64, which shares
no formula with this reference, must agree with it to a millionth of the ceiling, and the exact renderer must agree wherever float64
leaves it digits. The twin in f64 is itself the reference for decisions at thresholds, for scenes with too many layers for 106-bit
arithmetic, and for per-ray rasterization, which the papers' formulas do not cover.

A score is *largest relative error (share of the ceiling)*. The ceiling is 16 times the change of the reference when every input
moves by one f32 ulp, plus 1e-6 of the largest element. Rows of gradients must also be within 1e-3 of their length, unless one ulp
moves them by more than that. A case passes if no share exceeds 1, every value is finite (with the standard cuts too), exactly the
expected Gaussians are culled, and neighbours outside the extent of the hard Gaussians keep every bit of their pixels and gradients.
A case with a bound above the ceiling is *loose*, with the reason below the table, and does not count as passed.

Cases that are not one scene (captures far away, poison, loss and optimiser, training) state their own bounds, and their shares are
relative to those bounds.

The columns *textbook* show the same scenes computed in f32 by the formulas of most implementations: determinant `a·c − b²`, an
inverted covariance, an expanded quadratic form, division by `1 − α` in the backward pass. A dash means that the case does not use
these formulas. Cases that do not test a cut disable the cuts of faint layers and of almost opaque pixels, because cuts hide errors
of arithmetic: implementations that stop at a transmittance of 1e-4 never process the last of 10,000 layers. κ is the largest
condition number of a 2D covariance.
";

const COLUMNS: &str = "\
| case | why it is hard | hardness | CPU forward | CPU gradient | GPU forward | GPU gradient | passes | textbook forward | \
textbook gradient |
|---|---|---|---|---|---|---|---|---|---|
";

fn line(case: &HardCase, row: &CaseResult) -> String {
    let [cpu, gpu] = [Processor::Cpu, Processor::Gpu].map(|processor| row.of(processor));
    let verdict = match row.verdict() {
        // The GPU did not run the case.
        CaseVerdict::Passed if case.beyond_software.is_some() && gpu.is_none() => "yes, on the CPU",
        CaseVerdict::Passed => "yes",
        CaseVerdict::Loose => "loose",
        CaseVerdict::Failed => "**no**",
    };
    let forward = |outcome: &Option<CaseOutcome>| cell(outcome.as_ref().and_then(|outcome| outcome.forward));
    let gradient = |outcome: &Option<CaseOutcome>| cell(outcome.as_ref().and_then(|outcome| outcome.gradient));
    let cells = [
        case.name.clone(),
        case.why.into(),
        hardness(case, row),
        forward(&cpu),
        gradient(&cpu),
        forward(&gpu),
        gradient(&gpu),
        verdict.into(),
        forward(&row.textbook),
        gradient(&row.textbook),
    ];
    format!("| {} |\n", cells.map(|cell| cell.replace('|', "\\|")).join(" | "))
}

fn hardness(case: &HardCase, row: &CaseResult) -> String {
    let condition = (row.condition > 10.0).then(|| format!("κ {:.0e}", row.condition));
    let parts = [Some(case.hardness.clone()).filter(|text| !text.is_empty()), condition];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    if parts.is_empty() { "–".into() } else { parts.join("; ") }
}

/// Formats a score; a dash if nothing was measured.
fn cell(measured: Option<MeasuredDeviation>) -> String {
    measured.map_or("–".into(), score)
}

/// Formats `error (share)`, with a share above the ceiling in bold.
fn score(score: MeasuredDeviation) -> String {
    if !(score.error.is_finite() && score.used.is_finite()) {
        return "**not finite**".into();
    }
    let share = match score.used {
        used if used < 0.005 => "0".into(),
        used if used < 100.0 => format!("{used:.2}"),
        used => format!("{used:.0e}"),
    };
    let error = if score.error == 0.0 { "0".into() } else { format!("{:.0e}", score.error) };
    if score.used <= 1.0 { format!("{error} ({share})") } else { format!("{error} (**{share}**)") }
}

/// Most failures of a case that the table lists.
const FAILURES: usize = 4;

/// Notes on why a case is loose or fails, and on rows that the ceiling alone judged.
fn notes(case: &HardCase, row: &CaseResult) -> Vec<String> {
    let mut notes = Vec::new();
    for loose in &case.loose {
        let place = match loose.processor {
            Processor::Cpu => "the CPU",
            Processor::Gpu => "GPUs",
        };
        notes.push(format!(
            "- *{}* is allowed {} times the ceiling on {place}: {}.",
            case.name, loose.factor, loose.why
        ));
    }
    notes.extend(
        case.beyond_software.map(|why| format!("- *{}* does not run on drivers in software: {why}.", case.name)),
    );
    let ill = row.places.iter().map(|(_, outcome)| outcome.ill_rows).max().unwrap_or_default();
    if ill > 0 {
        let rows = if ill == 1 { "row" } else { "rows" };
        notes.push(format!("- *{}*: one ulp moves {ill} {rows} of gradients by more than 1e-3.", case.name));
    }
    let failures = row.failures();
    notes.extend(failures.iter().take(FAILURES).map(|failure| format!("- *{}* fails: {failure}.", case.name)));
    if failures.len() > FAILURES {
        notes.push(format!("- *{}* fails in {} more ways.", case.name, failures.len() - FAILURES));
    }
    notes
}
