//! A hard case, the places where it runs, and its outcome.

use burn::tensor::Device;

use crate::scene::HardScene;

/// One row of the table.
pub struct HardCase {
    /// Unique name that says in a few words what is hard.
    pub name: String,
    /// Why the case is hard, in a sentence.
    pub why: &'static str,
    /// How hard the case is, in numbers. The table appends the condition number of the scene's ellipses.
    pub hardness: String,
    /// The scenes or the function that the case runs.
    pub kind: CaseKind,
    /// Bounds above the ceiling, where f32 cannot meet it, with reasons. The table lists such a case as loose, never as passed.
    pub loose: Vec<Loose>,
    /// Why drivers in software cannot run the case, if they cannot. The table states that they did not.
    pub beyond_software: Option<&'static str>,
}

/// Kind of a case.
pub enum CaseKind {
    /// Scenes, each judged separately. The row shows the worst.
    Scenes(Vec<HardScene>),
    /// Any other check.
    Check(Check),
}

/// Function that runs a case on one path.
pub type Check = Box<dyn Fn(&TestDevice) -> CaseOutcome + Send + Sync>;

/// A bound above the ceiling.
#[derive(Clone, Copy, Debug)]
pub struct Loose {
    /// Kind of path that the bound applies to.
    pub processor: Processor,
    /// Allowed multiple of the ceiling, above 1.
    pub factor: f64,
    /// Why f32 cannot meet the ceiling.
    pub why: &'static str,
}

/// A path: a device, with its name in the table.
#[derive(Clone, Debug)]
pub struct TestDevice {
    pub name: String,
    pub device: Device,
    pub processor: Processor,
    /// Whether a GPU is a driver in software.
    pub software: bool,
}

/// Kind of processor. The table has a block of columns for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Processor {
    /// The CPU, which runs the CPU twins.
    Cpu,
    /// A GPU, which runs the kernels.
    Gpu,
}

/// Error of a result.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeasuredDeviation {
    /// Largest error, relative to the largest expected element of its tensor.
    pub error: f64,
    /// Largest error of an element as a share of its ceiling.
    pub used: f64,
}

/// Outcome of a case on one path. The default has passed, with nothing measured.
#[derive(Clone, Debug, Default)]
pub struct CaseOutcome {
    /// Score of the pictures.
    pub forward: Option<MeasuredDeviation>,
    /// Score of the gradients.
    pub gradient: Option<MeasuredDeviation>,
    /// Number of gradient rows that one ulp in the inputs moves by more than the tolerance for rows. The ceiling alone
    /// judges them.
    pub ill_rows: usize,
    /// Requirements that do not hold, one sentence each.
    pub failures: Vec<String>,
}

impl HardCase {
    /// Creates a case of scenes.
    pub fn scenes(name: impl Into<String>, why: &'static str, scenes: Vec<HardScene>) -> Self {
        Self::new(name.into(), why, CaseKind::Scenes(scenes))
    }

    /// Creates a case that runs a function.
    pub fn check(
        name: impl Into<String>,
        why: &'static str,
        check: impl Fn(&TestDevice) -> CaseOutcome + Send + Sync + 'static,
    ) -> Self {
        Self::new(name.into(), why, CaseKind::Check(Box::new(check)))
    }

    fn new(name: String, why: &'static str, kind: CaseKind) -> Self {
        Self { name, why, hardness: String::new(), kind, loose: Vec::new(), beyond_software: None }
    }

    /// Sets the text that says how hard the case is.
    pub fn hardness(self, hardness: impl Into<String>) -> Self {
        Self { hardness: hardness.into(), ..self }
    }

    /// Allows a bound above the ceiling on one kind of path.
    pub fn loose(mut self, processor: Processor, factor: f64, why: &'static str) -> Self {
        self.loose.push(Loose { processor, factor, why });
        self
    }

    /// Excludes drivers in software.
    pub fn beyond_software(self, why: &'static str) -> Self {
        Self { beyond_software: Some(why), ..self }
    }

    /// Allowed multiple of the ceiling on a kind of path.
    pub fn limit(&self, processor: Processor) -> f64 {
        self.loose.iter().filter(|loose| loose.processor == processor).fold(1.0, |limit, loose| limit.max(loose.factor))
    }
}

impl MeasuredDeviation {
    /// The worse value of each field; NaN if either is NaN.
    pub fn worst(self, other: Self) -> Self {
        let worst = |a: f64, b: f64| if a.is_nan() || a >= b { a } else { b };
        Self { error: worst(self.error, other.error), used: worst(self.used, other.used) }
    }
}

impl CaseOutcome {
    /// Whether every requirement holds.
    pub fn passed(&self) -> bool {
        self.failures.is_empty()
    }

    /// Records `what` as a failure unless `holds`.
    pub fn require(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.failures.push(what());
        }
    }

    /// Combines two outcomes, with the worse of each score.
    pub fn and(mut self, other: Self) -> Self {
        let worst = |a: Option<MeasuredDeviation>, b: Option<MeasuredDeviation>| match (a, b) {
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
        let (good, bad) =
            (MeasuredDeviation { error: 1.0, used: 2.0 }, MeasuredDeviation { error: f64::NAN, used: 0.5 });
        for worst in [good.worst(bad), bad.worst(good)] {
            assert!(worst.error.is_nan() && worst.used == 2.0, "{worst:?}");
        }
    }

    #[test]
    fn outcomes_add_up() {
        let mut first = CaseOutcome { ill_rows: 1, ..CaseOutcome::default() };
        assert!(first.passed());
        first.require(true, || unreachable!());
        first.require(false, || "first".into());
        let second = CaseOutcome { forward: Some(MeasuredDeviation::default()), ill_rows: 2, ..CaseOutcome::default() };
        let both = second.and(first);
        assert!(!both.passed() && both.ill_rows == 3 && both.forward.is_some() && both.gradient.is_none());
    }
}
