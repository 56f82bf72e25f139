//! Kernels against their twins: the largest accepted difference of an f32 result from the f64 one.
//!
//! The unit is the change of the f64 result for a change of one f32 ulp in every input. An element may be off by 16 such units plus
//! 1e-6 of the largest element of its column in its class. Classes keep extreme rows from loosening the limit of the others.
//! Subnormal numbers count as zero, because some devices flush them.

#![cfg_attr(not(feature = "cube"), allow(dead_code, reason = "the tests of kernels use the rest"))]

use super::random::Random;

/// Accepted multiple of the change for an ulp in every input.
const ULP_FACTOR: f64 = 16.0;
/// Addend of the limit, relative to the largest element of the column and class; also the relative width of a band.
const FLOOR: f64 = 1e-6;
/// Accepted relative error of a gradient's row, the share of rows that may exceed it, and the length, relative to the longest row,
/// below which a row is exempt from it.
const ROW_TOLERANCE: f64 = 1e-3;
const ROW_EXCEPTIONS: f64 = 1e-3;
const ROW_FLOOR: f64 = 1e-4;
/// Number of random perturbations of the inputs.
const DRAWS: u64 = 6;
/// Magnitude below which an f32, or an intermediate product, may have been flushed to zero.
const SMALLEST: f64 = 1e-36;

/// Whether nothing is compared: on the driver that launches nothing, `tests/cards/driver.c`, tests serve to launch every form of a kernel.
fn launches_only() -> bool {
    std::env::var_os("SPLAT_CAPABILITY").is_some()
}

/// Class of each row; `None` for a row in the boundary band, which is not compared.
pub type Classes = [Option<u8>];

/// Nearest f32 values.
pub fn rounded(values: &[f64]) -> Vec<f64> {
    values.iter().map(|value| f64::from(*value as f32)).collect()
}

pub fn to_f32(values: &[f64]) -> Vec<f32> {
    values.iter().map(|value| *value as f32).collect()
}

/// Moves each value one f32 ulp up or down. Zeros and values that are not finite stay: they are exact statements, not measurements.
fn moved(values: &[f64], random: &mut Random) -> Vec<f64> {
    let mut step = |value: f64| match value as f32 {
        exact if exact == 0.0 || !exact.is_finite() => value,
        value if random.between(0.0, 1.0) < 0.5 => f64::from(value.next_up()),
        value => f64::from(value.next_down()),
    };
    values.iter().map(|value| step(*value)).collect()
}

/// Results in f64 and the largest change of each element over several random perturbations.
pub struct PerturbedReference {
    pub expected: Vec<Vec<f64>>,
    pub spread: Vec<Vec<f64>>,
}

impl PerturbedReference {
    /// `inputs` must be rounded to f32 already.
    pub fn new(inputs: &[Vec<f64>], evaluate: impl Fn(&[Vec<f64>]) -> Vec<Vec<f64>>) -> Self {
        let expected = evaluate(inputs);
        let mut spread: Vec<Vec<f64>> = expected.iter().map(|tensor| vec![0.0; tensor.len()]).collect();
        for draw in 0..if launches_only() { 0 } else { DRAWS } {
            let mut random = Random::new(1000 + draw);
            let inputs: Vec<Vec<f64>> = inputs.iter().map(|tensor| moved(tensor, &mut random)).collect();
            for ((spread, plain), moved) in spread.iter_mut().zip(&expected).zip(evaluate(&inputs)) {
                let changes = plain.iter().zip(moved).map(|(plain, moved)| (plain - moved).abs());
                spread.iter_mut().zip(changes).for_each(|(spread, change)| *spread = spread.max(change));
            }
        }
        Self { expected, spread }
    }

    /// Whether each element, a relative distance from a threshold, lies within rounding of the threshold.
    pub fn near_zero(&self, tensor: usize) -> Vec<bool> {
        let elements = self.expected[tensor].iter().zip(&self.spread[tensor]);
        elements.map(|(value, spread)| value.abs() <= ULP_FACTOR * spread + FLOOR).collect()
    }

    /// Asserts the ceiling and returns the largest share of it that an element uses.
    pub fn check(&self, what: &str, tensor: usize, found: &[f32], classes: &Classes) -> f64 {
        if launches_only() {
            return 0.0;
        }
        let (expected, spread) = (&self.expected[tensor], &self.spread[tensor]);
        assert_eq!(found.len(), expected.len(), "{what}");
        let columns = expected.len() / classes.len().max(1);
        let mut largest = vec![0.0_f64; 256 * columns];
        for (row, class) in classes.iter().enumerate() {
            let Some(class) = class else { continue };
            for column in 0..columns {
                let largest = &mut largest[usize::from(*class) * columns + column];
                *largest = largest.max(expected[row * columns + column].abs());
            }
        }
        let mut worst = 0.0_f64;
        for (row, class) in classes.iter().enumerate() {
            let Some(class) = class else { continue };
            for column in 0..columns {
                let at = row * columns + column;
                let tolerance =
                    ULP_FACTOR * spread[at] + FLOOR * largest[usize::from(*class) * columns + column] + SMALLEST;
                let error = (f64::from(found[at]) - expected[at]).abs();
                assert!(
                    error <= tolerance,
                    "{what}, row {row} of class {class}, column {column}: found {:e}, expected {:e}, error {error:.2e}, \
                     tolerance {tolerance:.2e}",
                    found[at],
                    expected[at]
                );
                worst = worst.max(error / tolerance);
            }
        }
        worst
    }

    /// Asserts the ceiling of a gradient as [`Self::check`] does. Its rows are also compared as vectors, and zero rows must be the
    /// same. A row that one ulp in the inputs moves by more than the tolerance is subject to the ceiling alone; the share of such
    /// rows in `ordinary` classes is bounded.
    pub fn check_gradient(&self, what: &str, tensor: usize, found: &[f32], classes: &Classes, ordinary: &[u8]) -> f64 {
        if launches_only() {
            return 0.0;
        }
        let worst = self.check(what, tensor, found, classes);
        let (expected, spread) = (&self.expected[tensor], &self.spread[tensor]);
        let columns = expected.len() / classes.len().max(1);
        let length = |row: &mut dyn Iterator<Item = f64>| row.map(|v| v * v).sum::<f64>().sqrt();
        let mut rows = Vec::new();
        for (row, class) in classes.iter().enumerate() {
            let Some(class) = class else { continue };
            let range = row * columns..(row + 1) * columns;
            let (found, expected, spread) = (&found[range.clone()], &expected[range.clone()], &spread[range]);
            let size = length(&mut expected.iter().copied());
            let error = length(&mut found.iter().zip(expected).map(|(found, expected)| f64::from(*found) - expected));
            let uncertainty = length(&mut spread.iter().copied());
            // Zero by a decision, not by cancellation: it stays zero under all perturbations.
            let none = size == 0.0 && uncertainty == 0.0;
            let zero = found.iter().all(|value| *value == 0.0);
            let same = if none { zero } else { !zero || size <= ULP_FACTOR * uncertainty + SMALLEST };
            assert!(same, "{what}, row {row} of class {class}: found {found:?}, expected {expected:?}");
            rows.push((*class, size, error, uncertainty));
        }
        for class in 0..=u8::MAX {
            let of_class = || rows.iter().filter(|row| row.0 == class);
            // Devices that flush subnormal numbers may lose the digits of rows this small.
            let floor =
                (ROW_FLOOR * of_class().fold(0.0_f64, |largest, row| largest.max(row.1))).max(SMALLEST / ROW_TOLERANCE);
            let (mut judged, mut off, mut ill) = (0, 0, 0);
            for (_, size, error, spread) in of_class().filter(|row| row.1 > floor) {
                judged += 1;
                ill += usize::from(*spread > ROW_TOLERANCE * size);
                off += usize::from(*spread <= ROW_TOLERANCE * size && !(*error <= ROW_TOLERANCE * size));
            }
            let allowed = (ROW_EXCEPTIONS * f64::from(judged)).floor() as usize;
            assert!(off <= allowed, "{what}, class {class}: {off} of {judged} rows are off");
            let cancelling = if ordinary.contains(&class) { (0.01 * f64::from(judged)).ceil() as usize } else { ill };
            assert!(
                ill <= cancelling,
                "{what}, class {class}: {ill} of {judged} rows are too ill-conditioned to judge"
            );
        }
        worst
    }
}
