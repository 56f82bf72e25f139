//! Comparisons whose failures name the tensor. NaN always fails.

use crate::tensors::Named;

/// A measured error and its tolerance.
#[derive(Clone, Debug)]
pub struct Finding {
    pub what: String,
    pub error: f64,
    pub tolerance: f64,
}

/// Asserts that every finding is within its tolerance.
pub fn assert_all(findings: &[Finding]) {
    for Finding { what, error, tolerance } in findings {
        assert!(error <= tolerance, "{what}: error {error:.3e}, tolerance {tolerance:.3e}");
    }
}

/// Largest of non-negative numbers; NaN if one is NaN.
pub fn worst(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |worst, value| if worst.is_nan() || worst >= value { worst } else { value })
}

/// The largest magnitude.
pub fn largest(values: &[f64]) -> f64 {
    worst(values.iter().map(|v| v.abs()))
}

/// Euclidean length.
pub fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Largest difference divided by the largest expected magnitude.
pub fn relative_error(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    // Where all expected values are zero, only zero passes.
    let scale = largest(expected).max(f64::MIN_POSITIVE);
    worst(found.iter().zip(expected).map(|(f, e)| (f - e).abs() / scale))
}

/// Relative Euclidean error of each row whose length exceeds 1e-4 of the largest. Shorter rows lose their digits to the
/// magnitude of other rows before anything can use them.
pub fn row_errors(found: &Named, expected: &Named) -> Vec<f64> {
    assert_eq!(found.values.len(), expected.values.len(), "{}", expected.name);
    let values = found.values.iter().zip(&expected.values).map(|(f, e)| f - e).collect();
    row_sizes(&Named { values, ..expected.clone() }, expected)
}

/// Length of each row relative to the expected row's length, for the rows that [`row_errors`] judges.
pub fn row_sizes(rows: &Named, expected: &Named) -> Vec<f64> {
    let lengths = |tensor: &Named| -> Vec<f64> { tensor.values.chunks_exact(expected.columns).map(norm).collect() };
    let expected_lengths = lengths(expected);
    let floor = 1e-4 * largest(&expected_lengths);
    let pairs = lengths(rows).into_iter().zip(expected_lengths);
    pairs.filter(|(_, expected)| *expected > floor).map(|(length, expected)| length / expected).collect()
}

/// Returns the kept rows of a tensor.
pub fn keep_rows(tensor: &Named, kept: &[bool]) -> Named {
    let rows = tensor.values.chunks_exact(tensor.columns);
    assert_eq!(rows.len(), kept.len(), "{}", tensor.name);
    let values = rows.zip(kept).filter(|(_, kept)| **kept).flat_map(|(row, _)| row.iter().copied()).collect();
    Named { values, ..tensor.clone() }
}
