//! How far an f32 result may lie from the f64 one: sixteen times what one ulp in every input does to it, and a little.

use super::random::Random;

/// Draws of the perturbation: a lower estimate of what an ulp can do.
const DRAWS: u64 = 6;

/// Values moved by one f32 ulp each, up or down.
pub fn moved(values: &[f64], random: &mut Random) -> Vec<f64> {
    let step = |v: f32, up: bool| if up { v.next_up() } else { v.next_down() };
    let nudge = |&v: &f64, up: bool| if v == 0.0 { v } else { f64::from(step(v as f32, up)) };
    values.iter().map(|v| nudge(v, random.between(-1.0, 1.0) > 0.0)).collect()
}

/// Per element, `16 × change + 1e-6 × largest`, with `result` computed from inputs that `moved` has nudged.
pub fn ceiling(expected: &[f64], seed: u64, result: impl Fn(&mut Random) -> Vec<f64>) -> Vec<f64> {
    let largest = expected.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let mut change = vec![0.0_f64; expected.len()];
    for draw in 0..DRAWS {
        let nudged = result(&mut Random::new(1_000 * seed + draw));
        change.iter_mut().zip(&nudged).zip(expected).for_each(|((c, n), e)| *c = c.max((n - e).abs()));
    }
    change.iter().map(|c| 16.0 * c + 1e-6 * largest).collect()
}

/// Compares element by element; `what` names the result in the message.
pub fn check(what: &str, found: &[f32], expected: &[f64], ceiling: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{what}: number of elements");
    for (i, ((&found, &expected), &tolerance)) in found.iter().zip(expected).zip(ceiling).enumerate() {
        let error = (f64::from(found) - expected).abs();
        assert!(error <= tolerance, "{what}[{i}]: {found}, expected {expected}, error {error}, ceiling {tolerance}");
    }
}

/// Of the rows above 1e-4 of the largest, 99.9% have a relative L2 error of at most 1e-3.
pub fn check_rows(what: &str, found: &[f32], expected: &[f64], columns: usize) {
    let norm = |row: &[f64]| row.iter().map(|v| v * v).sum::<f64>().sqrt();
    let largest = expected.chunks_exact(columns).map(norm).fold(0.0, f64::max);
    let (mut rows, mut bad) = (0, 0);
    for (found, expected) in found.chunks_exact(columns).zip(expected.chunks_exact(columns)) {
        if norm(expected) > 1e-4 * largest {
            let error: Vec<f64> = found.iter().zip(expected).map(|(f, e)| f64::from(*f) - e).collect();
            rows += 1;
            bad += usize::from(!(norm(&error) <= 1e-3 * norm(expected)));
        }
    }
    assert!(bad * 1000 <= rows, "{what}: {bad} of {rows} rows are off by more than 1e-3");
}
