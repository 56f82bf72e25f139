//! The ceiling of f32 errors: how far a result may be from the f64 result.

use crate::compare::{largest, worst};
use crate::random::Random;

/// Multiple of the change that one ulp in every input causes.
pub const ULP_FACTOR: f64 = 16.0;
/// Added to the multiple of the spread, relative to the largest element.
pub const F32_FLOOR: f64 = 1e-6;
/// Allowed relative error of a gradient's row.
pub const ROW_TOLERANCE: f64 = 1e-3;
/// Share of a gradient's rows that may exceed [`ROW_TOLERANCE`].
pub const ROW_EXCEPTIONS: f64 = 1e-3;

/// Magnitude below which an f32 or an intermediate product may become zero, because some devices have no subnormal numbers.
pub const SMALLEST: f64 = 1e-36;

/// Rounds to the nearest f32.
pub fn rounded(value: f64) -> f64 {
    f64::from(value as f32)
}

/// Returns the value moved up or down by one f32 ulp.
pub fn moved_value(value: f64, random: &mut Random) -> f64 {
    let value = value as f32;
    f64::from(if random.between(0.0, 1.0) < 0.5 { value.next_up() } else { value.next_down() })
}

/// Largest error of an element as a share of its ceiling. `spread` is the change of the f64 result when every
/// input moves by one f32 ulp.
pub fn ceiling_used(found: &[f64], expected: &[f64], spread: &[f64]) -> f64 {
    assert_eq!((found.len(), expected.len()), (expected.len(), spread.len()));
    let floor = F32_FLOOR * largest(expected) + SMALLEST;
    let elements = found.iter().zip(expected).zip(spread);
    worst(elements.map(|((found, expected), spread)| (found - expected).abs() / (ULP_FACTOR * spread + floor)))
}
