//! The table of the battery, the content of `hard_cases.tsv`, and its summary.

use crate::case::{CaseOutcome, HardCase, MeasuredDeviation, Processor, TestDevice};
use crate::judge::{CaseResult, CaseVerdict};

/// The cases of one group, each with its result.
pub struct Section {
    pub title: &'static str,
    pub rows: Vec<(HardCase, CaseResult)>,
}

/// Names of the table's columns.
const COLUMNS: [&str; 12] = [
    "group",
    "case",
    "why",
    "hardness",
    "cpu_forward",
    "cpu_gradient",
    "gpu_forward",
    "gpu_gradient",
    "passes",
    "textbook_forward",
    "textbook_gradient",
    "notes",
];

/// Formats the table, one line per case with tabs between the cells. Figures are rounded so that the text changes only when a result
/// does.
pub fn tsv(sections: &[Section]) -> String {
    let mut text = COLUMNS.join("\t") + "\n";
    for section in sections {
        for (case, row) in &section.rows {
            let cells = cells(section.title, case, row).map(|cell| cell.replace(['\t', '\n'], " "));
            text.push_str(&(cells.join("\t") + "\n"));
        }
    }
    text
}

/// Formats what is printed: the devices, how many cases pass, and the notes on those that do not.
pub fn summary(sections: &[Section], places: &[TestDevice]) -> String {
    let rows = || sections.iter().flat_map(|section| &section.rows);
    let count = |verdict| rows().filter(|(_, row)| row.verdict() == verdict).count();
    let names: Vec<&str> = places.iter().map(|place| place.name.as_str()).collect();
    let mut text = format!(
        "Paths: {}. Of {} cases {} pass, {} are loose, {} fail.",
        names.join(", "),
        rows().count(),
        count(CaseVerdict::Passed),
        count(CaseVerdict::Loose),
        count(CaseVerdict::Failed),
    );
    if !places.iter().any(|place| place.processor == Processor::Gpu) {
        text.push_str("\nThe GPU was skipped: no adapter was found, or `SPLAT_GPU=skip`.");
    }
    for (case, row) in rows().filter(|(_, row)| row.verdict() != CaseVerdict::Passed) {
        text.push_str(&format!("\n{}: {}", case.name, notes(case, row).join("; ")));
    }
    text
}

fn cells(group: &str, case: &HardCase, row: &CaseResult) -> [String; 12] {
    let [cpu, gpu] = [Processor::Cpu, Processor::Gpu].map(|processor| row.of(processor));
    let verdict = match row.verdict() {
        // The GPU did not run the case.
        CaseVerdict::Passed if case.beyond_software.is_some() && gpu.is_none() => "yes, on the CPU",
        CaseVerdict::Passed => "yes",
        CaseVerdict::Loose => "loose",
        CaseVerdict::Failed => "no",
    };
    let forward = |outcome: &Option<CaseOutcome>| cell(outcome.as_ref().and_then(|outcome| outcome.forward));
    let gradient = |outcome: &Option<CaseOutcome>| cell(outcome.as_ref().and_then(|outcome| outcome.gradient));
    [
        group.into(),
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
        notes(case, row).join("; "),
    ]
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

/// Formats `error (share of the ceiling)`.
fn score(score: MeasuredDeviation) -> String {
    if !(score.error.is_finite() && score.used.is_finite()) {
        return "not finite".into();
    }
    let share = match score.used {
        used if used < 0.005 => "0".into(),
        used if used < 100.0 => format!("{used:.2}"),
        used => format!("{used:.0e}"),
    };
    let error = if score.error == 0.0 { "0".into() } else { format!("{:.0e}", score.error) };
    format!("{error} ({share})")
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
        notes.push(format!("allowed {} times the ceiling on {place}: {}", loose.factor, loose.why));
    }
    notes.extend(case.beyond_software.map(|why| format!("does not run on drivers in software: {why}")));
    let ill = row.places.iter().map(|(_, outcome)| outcome.ill_rows).max().unwrap_or_default();
    if ill > 0 {
        let rows = if ill == 1 { "row" } else { "rows" };
        notes.push(format!("one ulp moves {ill} {rows} of gradients by more than 1e-3"));
    }
    let failures = row.failures();
    notes.extend(failures.iter().take(FAILURES).map(|failure| format!("fails: {failure}")));
    if failures.len() > FAILURES {
        notes.push(format!("fails in {} more ways", failures.len() - FAILURES));
    }
    notes
}
