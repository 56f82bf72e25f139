//! What a case is, where it runs and what comes of it.

use burn::tensor::Device;

use crate::scene::HardScene;

/// One row of the table.
pub struct Case {
    /// What is hard, in a few words; unique.
    pub name: String,
    /// Why it is hard, in a sentence.
    pub why: &'static str,
    /// How hard it is, in numbers; the condition number of a scene's ellipses is added to it.
    pub hardness: String,
    /// What runs.
    pub kind: Kind,
    /// Bounds that f32 does not meet, and why. The table lists them as loose, never as passed.
    pub loose: Vec<Loose>,
    /// Why drivers in software cannot run it, if so. The table says that they did not.
    pub beyond_software: Option<&'static str>,
}

/// What a case runs.
pub enum Kind {
    /// Scenes, each judged on its own; the row shows the worst.
    Scenes(Vec<HardScene>),
    /// Anything else.
    Check(Check),
}

/// Runs a case on one path.
pub type Check = Box<dyn Fn(&Place) -> Outcome + Send + Sync>;

/// A bound above the ceiling.
#[derive(Clone, Copy, Debug)]
pub struct Loose {
    /// Where.
    pub processor: Processor,
    /// What may be used of the ceiling, above 1.
    pub factor: f64,
    /// Why f32 cannot do better.
    pub why: &'static str,
}

/// A path: a device, by the name that the table gives it.
#[derive(Clone, Debug)]
pub struct Place {
    pub name: String,
    pub device: Device,
    pub processor: Processor,
    /// Whether a GPU is a driver in software.
    pub software: bool,
}

/// What computes. The table has a block of columns for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Processor {
    /// The CPU twins.
    Cpu,
    /// The kernels.
    Gpu,
}

/// How far results are off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// The largest error relative to the largest element expected of its tensor.
    pub error: f64,
    /// The largest share of its ceiling that an element uses.
    pub used: f64,
}

/// What came of a case on one path. The default has passed, with nothing measured.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Of the pictures.
    pub forward: Option<Score>,
    /// Of the gradients.
    pub gradient: Option<Score>,
    /// Rows of gradients that one ulp in the inputs moves by more than the tolerance for rows, so that the ceiling alone
    /// judges them.
    pub ill_rows: usize,
    /// What does not hold, a sentence each.
    pub failures: Vec<String>,
}

impl Case {
    /// A case of scenes.
    pub fn scenes(name: impl Into<String>, why: &'static str, scenes: Vec<HardScene>) -> Self {
        Self::new(name.into(), why, Kind::Scenes(scenes))
    }

    /// A case of another kind.
    pub fn check(
        name: impl Into<String>,
        why: &'static str,
        check: impl Fn(&Place) -> Outcome + Send + Sync + 'static,
    ) -> Self {
        Self::new(name.into(), why, Kind::Check(Box::new(check)))
    }

    fn new(name: String, why: &'static str, kind: Kind) -> Self {
        Self { name, why, hardness: String::new(), kind, loose: Vec::new(), beyond_software: None }
    }

    /// With a measure of how hard it is.
    pub fn hardness(self, hardness: impl Into<String>) -> Self {
        Self { hardness: hardness.into(), ..self }
    }

    /// With a bound above the ceiling on one kind of path.
    pub fn loose(mut self, processor: Processor, factor: f64, why: &'static str) -> Self {
        self.loose.push(Loose { processor, factor, why });
        self
    }

    /// Not for drivers in software.
    pub fn beyond_software(self, why: &'static str) -> Self {
        Self { beyond_software: Some(why), ..self }
    }

    /// What may be used of the ceiling on a kind of path.
    pub fn limit(&self, processor: Processor) -> f64 {
        self.loose.iter().filter(|loose| loose.processor == processor).fold(1.0, |limit, loose| limit.max(loose.factor))
    }
}

impl Score {
    /// The worse of each; NaN if one is.
    pub fn worst(self, other: Self) -> Self {
        let worst = |a: f64, b: f64| if a.is_nan() || a >= b { a } else { b };
        Self { error: worst(self.error, other.error), used: worst(self.used, other.used) }
    }
}

impl Outcome {
    /// Whether all holds.
    pub fn passed(&self) -> bool {
        self.failures.is_empty()
    }

    /// Notes `what` as a failure unless it holds.
    pub fn require(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.failures.push(what());
        }
    }

    /// Both outcomes, the worse of each score.
    pub fn and(mut self, other: Self) -> Self {
        let worst = |a: Option<Score>, b: Option<Score>| match (a, b) {
            (Some(a), Some(b)) => Some(a.worst(b)),
            (a, b) => a.or(b),
        };
        self.failures.extend(other.failures);
        Self {
            forward: worst(self.forward, other.forward),
            gradient: worst(self.gradient, other.gradient),
            ill_rows: self.ill_rows + other.ill_rows,
            failures: self.failures,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_of_scores_keeps_nan() {
        let (good, bad) = (Score { error: 1.0, used: 2.0 }, Score { error: f64::NAN, used: 0.5 });
        for worst in [good.worst(bad), bad.worst(good)] {
            assert!(worst.error.is_nan() && worst.used == 2.0, "{worst:?}");
        }
    }

    #[test]
    fn outcomes_add_up() {
        let mut first = Outcome { ill_rows: 1, ..Outcome::default() };
        assert!(first.passed());
        first.require(true, || unreachable!());
        first.require(false, || "first".into());
        let second = Outcome { forward: Some(Score::default()), ill_rows: 2, ..Outcome::default() };
        let both = second.and(first);
        assert!(!both.passed() && both.ill_rows == 3 && both.forward.is_some() && both.gradient.is_none());
    }
}
