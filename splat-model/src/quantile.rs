//! Quantiles.

/// Reorders `values` and returns their quantile at `share`, from 0 to 1: the nearest value. `None` without values.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let at = (share * values.len().checked_sub(1)? as f64).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}
