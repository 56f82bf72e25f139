//! Counts that do not depend on a machine's load, and their comparison with the recorded counts.

use std::fmt::{self, Display, Write as _};

/// Relative change above which a count is reported.
const TOLERANCE: f64 = 0.05;

/// Counts of a pass.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Count {
    /// Name of the pass, [`crate::limit::PassKind::name`].
    pub pass: String,
    /// Instructions on the AVX2 path, one thread.
    pub instructions: u64,
    /// Total bytes allocated.
    pub allocated: u64,
    /// Most bytes held at a time, beyond the bytes held before.
    pub peak: u64,
}

impl Count {
    /// Returns each number with its name and the absolute growth that is always allowed: a few more instructions in a pass
    /// of a few thousand are not a regression.
    fn numbers(&self) -> [(u64, &'static str, u64); 3] {
        [
            (self.instructions, "instructions", 10_000),
            (self.allocated, "bytes allocated", 4_096),
            (self.peak, "bytes held at once", 4_096),
        ]
    }
}

/// A count that differs from the record.
#[derive(Clone, Debug, PartialEq)]
pub enum Difference {
    /// A count more than 5% above or below the record. Less is not a failure, but a gain that the test protects only after
    /// it is recorded.
    Changed { pass: String, what: &'static str, before: u64, now: u64 },
    /// A pass without a record.
    New { pass: String },
    /// A record without a pass.
    Gone { pass: String },
}

impl Difference {
    /// Whether the difference fails the comparison.
    pub fn fails(&self) -> bool {
        !matches!(self, Self::Changed { before, now, .. } if now < before)
    }
}

impl Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Changed { pass, what, before, now } => {
                let change = 100.0 * (*now as f64 / (*before).max(1) as f64 - 1.0);
                write!(f, "{pass}: {change:+.1}% {what}, {now} after {before}")
            }
            Self::New { pass } => write!(f, "{pass}: not on record"),
            Self::Gone { pass } => write!(f, "{pass}: on record, but not counted"),
        }
    }
}

/// Returns the differences, in the order of the passes.
pub fn compare(recorded: &[Count], found: &[Count]) -> Vec<Difference> {
    let mut differences = Vec::new();
    for count in found {
        let pass = || count.pass.clone();
        let Some(record) = recorded.iter().find(|record| record.pass == count.pass) else {
            differences.push(Difference::New { pass: pass() });
            continue;
        };
        for ((before, what, slack), (now, _, _)) in record.numbers().into_iter().zip(count.numbers()) {
            let apart = (before as f64 * TOLERANCE).max(slack as f64);
            if (now as f64 - before as f64).abs() > apart {
                differences.push(Difference::Changed { pass: pass(), what, before, now });
            }
        }
    }
    let gone = recorded.iter().filter(|record| !found.iter().any(|count| count.pass == record.pass));
    differences.extend(gone.map(|record| Difference::Gone { pass: record.pass.clone() }));
    differences
}

/// Writes a record: comments, then a tab-separated line per pass.
pub fn write(counts: &[Count], comments: &[&str]) -> String {
    let mut text = String::new();
    let columns = "pass\tinstructions\tbytes allocated\tbytes held at once";
    for line in comments.iter().chain([&columns]) {
        let _ = writeln!(text, "# {line}");
    }
    for Count { pass, instructions, allocated, peak } in counts {
        let _ = writeln!(text, "{pass}\t{instructions}\t{allocated}\t{peak}");
    }
    text
}

/// Reads a record of [`write()`].
///
/// # Errors
/// The line that has another form.
pub fn read(text: &str) -> Result<Vec<Count>, String> {
    let count = |line: &str| {
        let mut fields = line.split('\t');
        let pass = fields.next()?.to_owned();
        let mut number = || fields.next()?.parse().ok();
        let count = Count { pass, instructions: number()?, allocated: number()?, peak: number()? };
        fields.next().is_none().then_some(count)
    };
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
    lines.map(|line| count(line).ok_or_else(|| format!("not a record: {line:?}"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(pass: &str, instructions: u64, allocated: u64, peak: u64) -> Count {
        Count { pass: pass.into(), instructions, allocated, peak }
    }

    #[test]
    fn five_per_cent_more_is_growth() {
        let record = [count("rasterize", 1_000_000, 1_000_000, 1_000_000)];
        assert!(compare(&record, &record).is_empty());
        assert!(compare(&record, &[count("rasterize", 1_049_000, 1_049_000, 1_049_000)]).is_empty());
        let found = compare(&record, &[count("rasterize", 1_051_000, 1_000_000, 1_000_000)]);
        assert_eq!(found.len(), 1);
        assert!(found[0].fails());
        assert_eq!(found[0].to_string(), "rasterize: +5.1% instructions, 1051000 after 1000000");
        for found in
            [count("rasterize", 1_000_000, 1_051_000, 1_000_000), count("rasterize", 1_000_000, 1_000_000, 1_051_000)]
        {
            assert!(compare(&record, &[found]).iter().any(Difference::fails));
        }
    }

    #[test]
    fn less_is_reported_and_does_not_fail() {
        let found = compare(&[count("intersect", 1_000_000, 0, 0)], &[count("intersect", 900_000, 0, 0)]);
        assert_eq!(found.len(), 1);
        assert!(!found[0].fails());
    }

    #[test]
    fn little_is_not_growth_whatever_its_share() {
        assert!(compare(&[count("guard", 1_000, 8, 8)], &[count("guard", 9_000, 4_000, 4_000)]).is_empty());
        assert!(compare(&[count("guard", 1_000, 8, 8)], &[count("guard", 12_000, 8, 8)])[0].fails());
    }

    #[test]
    fn passes_that_come_or_go_fail() {
        let found = compare(&[count("a", 1, 1, 1)], &[count("b", 1, 1, 1)]);
        assert_eq!(found, [Difference::New { pass: "b".into() }, Difference::Gone { pass: "a".into() }]);
        assert!(found.iter().all(Difference::fails));
    }

    #[test]
    fn records_read_back_and_nothing_else_does() {
        let counts = [count("rasterize backward", 3, 2, 1), count("Adam", 0, u64::MAX, 7)];
        assert_eq!(read(&write(&counts, &["a comment"])), Ok(counts.to_vec()));
        for text in ["rasterize\t1\t2", "rasterize\t1\t2\t3\t4", "rasterize 1 2 3", "rasterize\t1\t-2\t3"] {
            assert!(read(text).is_err(), "{text}");
        }
    }
}
