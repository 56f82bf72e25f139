//! The cheapest setting that meets a target.

use thiserror::Error;

use super::frontier::{FrontierPoint, Spread, frontier, tenths};
use super::measured::{Frontier, Measured, STANDARD};

/// Requirements on a setting. At least one field should be set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Target {
    /// Minimum PSNR against the exact render, dB.
    pub error_db: Option<f64>,
    /// Maximum time of a frame, ms, compared with the upper quartile of the measurements.
    pub ms: Option<f64>,
}

/// The work that the time of a frame covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Workload {
    /// A render.
    Render,
    /// A render and its backward pass.
    Train,
}

/// A setting that meets a target, and the reason for the choice.
#[derive(Clone, Debug, PartialEq)]
pub struct ChosenSetting {
    /// The setting with its measurements.
    pub measured: Measured,
    /// One sentence with the changed dials, the cost of the setting and the cost of the standard.
    pub why: String,
}

/// A target that no measured setting meets.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("no measured setting {wanted}: {best}")]
pub struct NoChoice {
    /// The target, in words.
    wanted: String,
    /// The closest settings, in words.
    best: String,
}

impl Workload {
    /// The time of a frame.
    pub fn time(self, measured: &Measured) -> Spread {
        match self {
            Self::Render => measured.forward_ms,
            Self::Train => measured.step_ms,
        }
    }

    /// Name of the work, for messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Render => "a frame",
            Self::Train => "a frame with its backward pass",
        }
    }
}

impl Target {
    /// Whether no field is set.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    fn is_met(&self, measured: &Measured, work: Workload) -> bool {
        let accurate = self.error_db.is_none_or(|least| measured.error_db >= least);
        accurate && self.ms.is_none_or(|most| work.time(measured).upper <= most)
    }

    fn wanted(&self, work: Workload) -> String {
        let error = self.error_db.map(|least| format!("reaches {least} dB against the exact render"));
        let time = self.ms.map(|most| format!("takes at most {most} ms for {}", work.name()));
        error.into_iter().chain(time).collect::<Vec<_>>().join(" and ")
    }
}

impl Frontier {
    /// Returns the cheapest setting that meets `target`, or the most accurate one if only a time is given. Settings that are
    /// not measurably faster than a more accurate one are not considered. Among settings that differ measurably in neither
    /// error nor time, the one that changes the fewest dials is chosen.
    ///
    /// # Errors
    /// [`NoChoice`], which names the closest settings, if no setting meets the target.
    pub fn choose(&self, target: &Target, work: Workload) -> Result<ChosenSetting, NoChoice> {
        let point = |measured: &Measured| FrontierPoint { quality_db: measured.error_db, time: work.time(measured) };
        let points: Vec<FrontierPoint> = self.settings.iter().map(point).collect();
        let members: Vec<&Measured> = frontier(&points).into_iter().map(|i| &self.settings[i]).collect();
        let mut meeting = members.iter().copied().filter(|measured| target.is_met(measured, work));
        let found = if target.error_db.is_some() { meeting.next_back() } else { meeting.next() };
        match found {
            Some(measured) => {
                let measured = self.simplest(measured, target, work);
                Ok(ChosenSetting { measured: measured.clone(), why: self.why(measured, work) })
            }
            None => Err(NoChoice { wanted: target.wanted(work), best: closest(&members, work) }),
        }
    }

    /// The setting that changes the fewest dials among those that do not differ measurably from `chosen`; the first of several.
    fn simplest<'a>(&'a self, chosen: &'a Measured, target: &Target, work: Workload) -> &'a Measured {
        let alike = |other: &&Measured| {
            let as_accurate = tenths(other.error_db) == tenths(chosen.error_db);
            as_accurate && work.time(other).overlaps(&work.time(chosen)) && target.is_met(other, work)
        };
        let simpler = self.settings.iter().filter(alike).min_by_key(|other| other.turned.values().count());
        simpler.unwrap_or(chosen)
    }

    fn why(&self, chosen: &Measured, work: Workload) -> String {
        let mut why = format!(
            "{} ({}): {:.1} dB against the exact render, {:.2} ms for {}",
            chosen.name,
            chosen.turned,
            chosen.error_db,
            work.time(chosen).median,
            work.name()
        );
        let standard = self.settings.iter().find(|measured| measured.name == STANDARD && measured.name != chosen.name);
        if let Some(standard) = standard {
            let (ours, theirs) = (work.time(chosen), work.time(standard));
            let told = if ours.overlaps(&theirs) { ", not a measurable difference" } else { "" };
            let (db, ms) = (standard.error_db, theirs.median);
            why.push_str(&format!("; the standard has {db:.1} dB and takes {ms:.2} ms{told}"));
        }
        why
    }
}

/// Describes both ends of the frontier.
fn closest(members: &[&Measured], work: Workload) -> String {
    let said = |what: &str, m: &Measured| {
        format!("the {what} is {} ({}), {:.1} dB in {:.2} ms", m.name, m.turned, m.error_db, work.time(m).upper)
    };
    match members {
        [] => "none was measured".into(),
        [only] => said("only useful setting", only),
        [first, .., last] => format!("{}; {}", said("most accurate", first), said("fastest", last)),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::provenance::Provenance;
    use super::super::setting::Setting;
    use super::*;

    pub fn measured<const N: usize>(name: &str, turned: [(&str, &str); N], error_db: f64, ms: f64) -> Measured {
        let around = |ms: f64| Spread { lower: 0.95 * ms, median: ms, upper: 1.05 * ms };
        Measured {
            name: name.into(),
            turned: Setting::new(turned).unwrap(),
            error_db,
            max_error: 0.01,
            gradient_error: Some(0.1),
            gradient_cosine: Some(0.99),
            forward_ms: around(ms),
            backward_ms: around(2.0 * ms),
            step_ms: around(3.0 * ms),
        }
    }

    fn some() -> Frontier {
        let settings = vec![
            measured("fast", [("alpha_min", "4/255")], 40.0, 3.0),
            measured("exact", [("alpha_min", "2^-26")], 80.0, 9.0),
            measured(STANDARD, [], 55.0, 5.0),
            // Faster than the standard by the median, but not measurably.
            measured("in between", [("alpha_min", "2/255")], 50.0, 4.8),
        ];
        Frontier { device: "flex".into(), provenance: Provenance::default(), splats: 1, pixels: 1, settings }
    }

    fn chosen(error_db: Option<f64>, ms: Option<f64>, work: Workload) -> Result<String, String> {
        let choice = some().choose(&Target { error_db, ms }, work);
        choice.map(|choice| choice.measured.name).map_err(|none| none.to_string())
    }

    #[test]
    fn the_cheapest_that_is_accurate_enough() {
        for (least, expected) in [(30.0, "fast"), (40.0, "fast"), (40.1, STANDARD), (50.0, STANDARD), (60.0, "exact")] {
            assert_eq!(chosen(Some(least), None, Workload::Render).unwrap(), expected, "{least} dB");
        }
    }

    #[test]
    fn the_most_accurate_that_is_fast_enough() {
        for (most, expected) in [(3.2, "fast"), (5.2, "fast"), (5.25, STANDARD), (9.0, STANDARD), (100.0, "exact")] {
            assert_eq!(chosen(None, Some(most), Workload::Render).unwrap(), expected, "{most} ms");
        }
        assert_eq!(chosen(None, Some(10.0), Workload::Train).unwrap(), "fast", "a backward pass counts too");
        assert_eq!(
            chosen(Some(41.0), Some(100.0), Workload::Render).unwrap(),
            STANDARD,
            "of those that meet both, the cheapest"
        );
    }

    #[test]
    fn of_equals_the_one_that_turns_least() {
        let mut all = some();
        // As accurate as the standard, a little faster, but not measurably.
        all.settings.insert(0, measured("capped", [("alpha_max", "0.999")], 55.01, 4.9));
        let target = Target { error_db: Some(51.0), ms: None };
        assert_eq!(all.choose(&target, Workload::Render).unwrap().measured.name, STANDARD);
        // The capped setting is chosen where it alone meets the time.
        let target = Target { error_db: Some(51.0), ms: Some(5.2) };
        assert_eq!(all.choose(&target, Workload::Render).unwrap().measured.name, "capped");
    }

    #[test]
    fn what_nothing_meets_is_refused_with_what_there_is() {
        let error = chosen(Some(90.0), None, Workload::Render).unwrap_err();
        for part in ["reaches 90 dB", "the most accurate is exact (alpha_min 2^-26), 80.0 dB", "the fastest is fast"] {
            assert!(error.contains(part), "{part:?} is not in {error}");
        }
        let error = chosen(Some(50.0), Some(1.0), Workload::Train).unwrap_err();
        assert!(
            error.contains("reaches 50 dB against the exact render and takes at most 1 ms for a frame with its back"),
            "{error}"
        );
        let nothing = Frontier { settings: Vec::new(), ..some() };
        let error = nothing.choose(&Target { ms: Some(1.0), ..Target::default() }, Workload::Render).unwrap_err();
        assert!(error.to_string().ends_with("none was measured"));
    }

    #[test]
    fn the_reason_names_dials_and_the_standard() {
        let target = Target { error_db: Some(30.0), ms: None };
        let why = some().choose(&target, Workload::Render).unwrap().why;
        let expected = "fast (alpha_min 4/255): 40.0 dB against the exact render, 3.00 ms for a frame; the standard has \
                        55.0 dB and takes 5.00 ms";
        assert_eq!(why, expected);
        let target = Target { error_db: Some(51.0), ms: None };
        assert!(!some().choose(&target, Workload::Render).unwrap().why.contains("; the standard"));
    }
}
