//! Quantiles.

/// Sorts `values` and returns their quantile at `share`, from 0 to 1: the nearest value. `None` without values.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let at = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(at).copied()
}
