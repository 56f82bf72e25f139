//! The written page: measured figures between two marks. The text around the marks stays unchanged.

use super::{EffectCase, EffectGain, RunSize};

/// Mark before the measured figures.
const BEGIN: &str = "<!-- measured by `splat effects`: begin -->";

/// Mark after the measured figures.
const END: &str = "<!-- measured by `splat effects`: end -->";

/// The text before and after the marks of a new page.
pub(super) const NEW: (&str, &str) =
    ("# Effects\n\nWhat each effect gains on a demo capture that shows it and nothing else.\n\n", "\n");

/// Returns the text before and after the marks of an existing page. `None` if the page has no marks.
pub(super) fn around(page: &str) -> Option<(&str, &str)> {
    let (before, rest) = page.split_once(BEGIN)?;
    Some((before, rest.split_once(END)?.1))
}

/// The table, with one line per case.
pub(super) fn table(gains: &[(&EffectCase, EffectGain)]) -> String {
    let mut text = String::from(
        "| demo | `auto` switches on | evidence | without, dB | with, dB | gain, dB | training without and with, s |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for (case, gain) in gains {
        let mut names: Vec<&str> = gain.planned.iter().map(|effect| effect.name()).collect();
        names.extend((case.harmonics == Some(true) && gain.harmonics).then_some("harmonics"));
        let names = if names.is_empty() { "nothing".into() } else { names.join(", ") };
        let [without, with] = gain.score_db;
        let flags = if case.demo_flags.is_empty() { "plain".into() } else { format!("`{}`", case.demo_flags) };
        let [before, after] = gain.seconds;
        text.push_str(&format!(
            "| {flags} | {names} | {} | {without:.2} | {with:.2} | {:+.2} | {before:.0}, {after:.0} |\n",
            gain.evidence,
            with - without,
        ));
    }
    text
}

/// The complete page.
pub(super) fn page((before, after): (&str, &str), table: &str, scale: &RunSize) -> String {
    let RunSize { width, views, steps } = *scale;
    let size = format!("{views} photographs of {width} × {} px, {steps} steps.", 3 * width / 4);
    format!("{before}{BEGIN}\n\n{size}\n\n{}\n\n{END}{after}", table.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_and_what_was_measured_is_replaced() {
        let first = page(NEW, "| old |\n", &RunSize::QUICK);
        let edited = format!("Mine.\n\n{first}\n## More\n");
        let second = page(around(&edited).unwrap(), "| new |\n", &RunSize::FULL);
        assert!(second.starts_with("Mine.\n\n# Effects") && second.ends_with("\n## More\n"), "{second}");
        assert!(second.contains("1500 steps.\n\n| new |\n\n<!--") && !second.contains("old"), "{second}");
        assert_eq!(page(around(&second).unwrap(), "| new |", &RunSize::FULL), second);
        assert!(around(&second.replace(END, "")).is_none());
    }
}
