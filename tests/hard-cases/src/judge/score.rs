//! Errors of tensors and of their rows, measured against a reference and its uncertainty.

use crate::case::{CaseOutcome, MeasuredDeviation};
use crate::ceiling::{ROW_EXCEPTIONS, ROW_TOLERANCE, SMALLEST, ceiling_used};
use crate::compare::{largest, norm, worst};
use crate::tensors::Named;

/// Worst score of the parts of `[found, expected, spread]`, each relative to its own largest element.
pub fn score_parts(
    [found, expected, spread]: &[Vec<Named>; 3],
    outcome: &mut CaseOutcome,
    limit: f64,
) -> MeasuredDeviation {
    let mut score = MeasuredDeviation::default();
    for ((found, expected), spread) in found.iter().zip(expected).zip(spread) {
        let name = found.name;
        let finite = found.values.iter().all(|v| v.is_finite());
        outcome.require(finite, || format!("{name} is not finite"));
        let used = ceiling_used(&found.values, &expected.values, &spread.values);
        outcome.require(used <= limit, || format!("{name} uses {used:.2e} of its ceiling"));
        // A relative error means nothing where the reference is zero within its own uncertainty.
        let largest = largest(&expected.values).max(largest(&spread.values)).max(SMALLEST);
        let errors = found.values.iter().zip(&expected.values).map(|(f, e)| (f - e).abs());
        let error = worst(errors) / if largest > 0.0 { largest } else { 1.0 };
        score = score.worst(MeasuredDeviation { error, used });
    }
    score
}

/// Judges the rows of a gradient as vectors: off by more than the tolerance, or too ill-conditioned for it.
pub fn judge_rows(found: &Named, expected: &Named, spread: &Named, limit: f64, outcome: &mut CaseOutcome) {
    let lengths = |values: &[f64]| values.chunks(expected.columns).map(norm).collect::<Vec<f64>>();
    let (sizes, spreads) = (lengths(&expected.values), lengths(&spread.values));
    let errors: Vec<f64> = found.values.iter().zip(&expected.values).map(|(f, e)| f - e).collect();
    let floor = (1e-4 * largest(&sizes)).max(SMALLEST);
    let rows = lengths(&errors).into_iter().zip(sizes).zip(spreads);
    let (mut judged, mut off) = (0_usize, Vec::new());
    for (row, ((error, size), spread)) in rows.enumerate().filter(|(_, ((_, size), _))| *size > floor) {
        judged += 1;
        match spread > ROW_TOLERANCE * size {
            true => outcome.ill_rows += 1,
            false if !(error <= limit * ROW_TOLERANCE * size) => off.push((row, error / size)),
            false => {}
        }
    }
    let allowed = (ROW_EXCEPTIONS * judged as f64).floor() as usize;
    outcome.require(off.len() <= allowed, || {
        let (row, error) = off[0];
        format!("{}: {} of {judged} rows are off, the first is row {row} by {error:.1e}", found.name, off.len())
    });
}

/// Returns the rows of the kept pixels.
pub fn keep(tensor: &Named, kept: &[bool]) -> Named {
    let rows = tensor.values.chunks(tensor.columns).zip(kept).filter(|(_, kept)| **kept);
    Named { values: rows.flat_map(|(row, _)| row.iter().copied()).collect(), ..tensor.clone() }
}

/// Splits a tensor into columns, because channels may differ in magnitude.
pub fn columns(tensor: &Named) -> Vec<Named> {
    let column = |i: usize| tensor.values.iter().skip(i).step_by(tensor.columns).copied().collect();
    (0..tensor.columns).map(|i| Named { columns: 1, values: column(i), ..tensor.clone() }).collect()
}
