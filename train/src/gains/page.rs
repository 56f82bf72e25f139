//! The page: prose that people wrote around the table that was measured.

use super::{Case, Gain, Scale};

/// Where the table and the sizes go.
const PROSE: &str = include_str!("page.md");

/// A line per case.
pub(super) fn table(gains: &[(&Case, Gain)]) -> String {
    let mut text = String::from(
        "| demo | `auto` switches on | evidence | without, dB | with, dB | gain, dB | cost: ms a step, MiB | training, s |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for (case, gain) in gains {
        let mut names: Vec<&str> = gain.planned.iter().map(|effect| effect.name()).collect();
        names.extend((case.harmonics == Some(true) && gain.harmonics).then_some("harmonics"));
        let names = if names.is_empty() { "nothing".into() } else { names.join(", ") };
        let [without, with] = gain.score_db;
        let flags = if case.demo_flags.is_empty() { "plain".into() } else { format!("`{}`", case.demo_flags) };
        let cost = gain.cost.map_or("–".into(), |[ms, mib]| format!("{ms:.1}, {mib:.2}"));
        let [before, after] = gain.seconds;
        text.push_str(&format!(
            "| {flags} | {names} | {} | {without:.2} | {with:.2} | {:+.2} | {cost} | {before:.0}, {after:.0} |\n",
            gain.evidence,
            with - without,
        ));
    }
    text
}

/// All of it.
pub(super) fn page(table: &str, scale: &Scale) -> String {
    let Scale { width, views, steps } = *scale;
    let size = format!("{views} photographs of {width} × {} px, {steps} steps", 3 * width / 4);
    PROSE.replace("{{table}}", table.trim_end()).replace("{{size}}", &size)
}
