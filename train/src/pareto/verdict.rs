//! Verdicts on dials. They follow from rules, so that no hand-written sentence can contradict the next measurement.

use splat_model::accuracy::{FrontierPoint, Spread, frontier};

/// Limit of visibility in an 8-bit picture: a root mean square error of half a level, `−20 log₁₀(0.5 / 255)` dB.
pub const INVISIBLE_DB: f64 = 54.15;

/// Gradients within 1% of the exact ones, in dB. Gradients of two photographs differ by a hundred times as much.
pub const HARMLESS_DB: f64 = 40.0;

/// Measurement of one value of a dial.
#[derive(Clone, Debug, PartialEq)]
pub struct Graded {
    /// Name of the value.
    pub value: String,
    /// Quality relative to the exact reference, dB; higher is better.
    pub quality_db: f64,
    pub time: Spread,
}

/// Verdict on a dial.
#[derive(Clone, Debug, PartialEq)]
pub enum DialVerdict {
    /// All values are equally accurate, and their times cannot be told apart.
    NoDifference,
    /// One value is measurably faster than another, and no less accurate.
    Free { value: String, than: String, saved: f64 },
    /// A value saves time, and its error is harmless.
    Cheap { value: String, than: String, saved: f64, quality_db: f64 },
    /// Some values save time, but the error of each of them shows. `value` is the fastest.
    Dear { value: String, than: String, saved: f64, quality_db: f64 },
    /// Values are less accurate, and none is measurably faster than the most accurate.
    SavesNothing { best: String },
    /// All less accurate values are measurably slower than the most accurate.
    NeverWorthIt { best: String },
}

/// Judges the values of a dial. A quality of at least `harmless_db` is harmless. `None` for fewer
/// than two values.
pub fn verdict(values: &[Graded], harmless_db: f64) -> Option<DialVerdict> {
    let tenths = |graded: &Graded| (10.0 * graded.quality_db).round();
    let points: Vec<FrontierPoint> =
        values.iter().map(|v| FrontierPoint { quality_db: v.quality_db, time: v.time }).collect();
    let members: Vec<&Graded> = frontier(&points).into_iter().map(|i| &values[i]).collect();
    let (best, others) = members.split_first()?;
    if values.len() < 2 {
        return None;
    }
    let saved = |faster: &Graded, slower: &Graded| 1.0 - faster.time.median / slower.time.median;
    let harmless = others.iter().rev().find(|graded| graded.quality_db >= harmless_db);
    if let Some(found) = harmless.or(others.last()) {
        let (value, than) = (found.value.clone(), best.value.clone());
        let (saved, quality_db) = (saved(found, best), found.quality_db);
        return Some(match harmless.is_some() {
            true => DialVerdict::Cheap { value, than, saved, quality_db },
            false => DialVerdict::Dear { value, than, saved, quality_db },
        });
    }
    let equals = || values.iter().filter(|graded| tenths(graded) == tenths(best));
    let slowest = equals().filter(|graded| best.time.is_below(&graded.time));
    if let Some(slower) = slowest.max_by(|a, b| a.time.median.total_cmp(&b.time.median)) {
        let (value, than) = (best.value.clone(), slower.value.clone());
        return Some(DialVerdict::Free { value, than, saved: saved(best, slower) });
    }
    let worse: Vec<&Graded> = values.iter().filter(|graded| tenths(graded) < tenths(best)).collect();
    let best_name = best.value.clone();
    Some(match worse.iter().all(|graded| best.time.is_below(&graded.time)) {
        _ if worse.is_empty() => DialVerdict::NoDifference,
        true => DialVerdict::NeverWorthIt { best: best_name },
        false => DialVerdict::SavesNothing { best: best_name },
    })
}

impl DialVerdict {
    /// Whether no value but the most accurate is worth choosing.
    pub fn is_dominated(&self) -> bool {
        matches!(self, Self::SavesNothing { .. } | Self::NeverWorthIt { .. })
    }

    /// Returns the rest of a sentence that begins with the dial or its purpose.
    pub fn sentence(&self) -> String {
        let percent = |share: &f64| format!("{:.0}%", 100.0 * share);
        match self {
            Self::NoDifference => {
                "makes no difference: all values are equally accurate, and their times overlap".into()
            }
            Self::Free { value, than, saved } => {
                format!("free: {value} saves {} over {than} and is as accurate", percent(saved))
            }
            Self::Cheap { value, than, saved, quality_db } => format!(
                "cheap: {value} saves {} over {than}, and its error is harmless ({quality_db:.1} dB)",
                percent(saved)
            ),
            Self::Dear { value, than, saved, quality_db } => format!(
                "dear: what saves time shows. The fastest, {value}, saves {} over {than} at {quality_db:.1} dB",
                percent(saved)
            ),
            Self::SavesNothing { best } => {
                format!("saves nothing: no value is measurably faster than {best}, the most accurate")
            }
            Self::NeverWorthIt { best } => {
                format!("never worth it: every other value is measurably slower than {best}, and less accurate")
            }
        }
    }
}

/// Compares the values of a model choice, `(name, PSNR, time)`, with the scene's own value by photographs. Returns half
/// a sentence.
pub fn choice(values: &[(String, f64, Spread)], own: &str) -> Option<String> {
    let (_, own_db, own_time) = values.iter().find(|(name, ..)| name == own)?;
    let (name, db, time) = values.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let pace = |time: &Spread| match (time.is_below(own_time), own_time.is_below(time)) {
        (true, _) => "measurably faster",
        (_, true) => "measurably slower",
        _ => "not told apart in time",
    };
    let gained = db - own_db;
    Some(match gained < 0.05 {
        true => {
            let faster: Vec<String> = values
                .iter()
                .filter(|(_, _, time)| time.is_below(own_time))
                .map(|(name, db, time)| format!("{name} ({:+.2} dB, {})", db - own_db, pace(time)))
                .collect();
            let rest = if faster.is_empty() { "no value is measurably faster".into() } else { faster.join(", ") };
            format!("{own}, the scene's own, is as good as any; {rest}")
        }
        false => format!("{name} is {gained:+.2} dB better than {own}, the scene's own, and {}", pace(time)),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn graded(value: &str, quality_db: f64, ms: f64) -> Graded {
        Graded { value: value.into(), quality_db, time: Spread { lower: 0.95 * ms, median: ms, upper: 1.05 * ms } }
    }

    fn of<const N: usize>(values: [Graded; N]) -> DialVerdict {
        verdict(&values, INVISIBLE_DB).unwrap()
    }

    #[test]
    fn a_harmless_saving_is_cheap_and_the_largest_is_named() {
        let found =
            of([graded("a", 100.0, 10.0), graded("b", 70.0, 8.0), graded("c", 60.0, 5.0), graded("d", 30.0, 2.0)]);
        let DialVerdict::Cheap { value, than, saved, quality_db } = &found else { panic!("{found:?}") };
        assert_eq!((value.as_str(), than.as_str(), *quality_db), ("c", "a", 60.0));
        assert!((saved - 0.5).abs() < 1e-12 && !found.is_dominated());
        assert_eq!(found.sentence(), "cheap: c saves 50% over a, and its error is harmless (60.0 dB)");
    }

    #[test]
    fn a_saving_that_shows_is_dear() {
        let found = of([graded("a", 100.0, 10.0), graded("b", 50.0, 8.0), graded("c", 30.0, 4.0)]);
        assert!(
            found.sentence().starts_with("dear: what saves time shows. The fastest, c, saves 60% over a at 30.0 dB")
        );
    }

    #[test]
    fn what_is_as_accurate_and_faster_is_free() {
        let found = of([graded("box", 60.0, 10.0), graded("ellipse", 60.0, 7.0), graded("tight box", 60.04, 8.5)]);
        assert_eq!(found.sentence(), "free: ellipse saves 30% over box and is as accurate");
    }

    #[test]
    fn an_error_for_nothing_is_said_so() {
        let found = of([graded("a", 100.0, 10.0), graded("b", 50.0, 10.2), graded("c", 40.0, 30.0)]);
        assert_eq!(found, DialVerdict::SavesNothing { best: "a".into() });
        let found = of([graded("a", 100.0, 10.0), graded("b", 50.0, 12.0)]);
        assert_eq!(found, DialVerdict::NeverWorthIt { best: "a".into() });
        assert!(found.is_dominated() && found.sentence().starts_with("never worth it"));
        assert_eq!(of([graded("a", 100.0, 10.0), graded("b", 100.0, 10.1)]), DialVerdict::NoDifference);
        assert_eq!(verdict(&[graded("a", 1.0, 1.0)], INVISIBLE_DB), None);
        assert_eq!(verdict(&[], INVISIBLE_DB), None);
    }

    #[test]
    fn photographs_judge_choices() {
        let value = |name: &str, db: f64, ms: f64| (name.to_owned(), db, graded("", 0.0, ms).time);
        let own = [value("0.3", 25.0, 10.0), value("0.1", 25.5, 10.1)];
        assert_eq!(
            choice(&own, "0.3").unwrap(),
            "0.1 is +0.50 dB better than 0.3, the scene's own, and not told apart in time"
        );
        let own = [value("off", 25.0, 10.0), value("on", 24.0, 7.0)];
        let expected = "off, the scene's own, is as good as any; on (-1.00 dB, measurably faster)";
        assert_eq!(choice(&own, "off").unwrap(), expected);
        assert_eq!(choice(&own, "neither"), None);
    }

    fn some() -> impl Strategy<Value = Vec<Graded>> {
        let one =
            (300_u16..1200, 1_u8..40).prop_map(|(tenths, ms)| graded("v", f64::from(tenths) / 10.0, f64::from(ms)));
        prop::collection::vec(one, 2..8)
    }

    proptest! {
        /// A dial saves time exactly if some value is measurably faster than the most accurate one.
        #[test]
        fn a_dial_is_dominated_where_nothing_is_faster(values in some()) {
            let found = verdict(&values, INVISIBLE_DB).unwrap();
            let most = values.iter().map(|v| v.quality_db).fold(f64::MIN, f64::max);
            let best = values.iter().filter(|v| v.quality_db == most).map(|v| v.time).reduce(|a, b| if a.upper <= b.upper { a } else { b });
            let faster = values.iter().any(|v| v.time.is_below(&best.unwrap()));
            let saves = matches!(found, DialVerdict::Cheap { .. } | DialVerdict::Dear { .. });
            prop_assert_eq!(saves, faster, "{:?}", found);
        }

        #[test]
        fn what_is_called_harmless_is(values in some()) {
            match verdict(&values, INVISIBLE_DB).unwrap() {
                DialVerdict::Cheap { quality_db, saved, .. } => prop_assert!(quality_db >= INVISIBLE_DB && saved > 0.0),
                DialVerdict::Dear { quality_db, saved, .. } => prop_assert!(quality_db < INVISIBLE_DB && saved > 0.0),
                _ => {}
            }
        }
    }
}
