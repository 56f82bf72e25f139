//! Codebooks of 256 values: scalar quantisers with a small mean square error.
//!
//! The sorted values are split into cells, each time the cell with the largest sum of squared differences from its mean, at its mean. Lloyd's
//! iteration (1982) then moves the borders to the middles between means. A few values far from the others take a few cells, and cost the others
//! no precision.

use rayon::prelude::*;

use super::LEVELS;

/// Number of Lloyd's iterations, after which the error of normally distributed values is within a percent of its limit.
const ITERATIONS: usize = 12;

/// A codebook and the indices of the values in it.
pub struct Quantised {
    /// 256 values in ascending order; the last is repeated where fewer do.
    pub codebook: Vec<f32>,
    /// The index of the nearest value.
    pub indices: Vec<u8>,
}

/// Quantises finite values.
pub fn quantise(values: &[f32]) -> Quantised {
    let mut sorted = values.to_vec();
    sorted.par_sort_unstable_by(f32::total_cmp);
    let means = lloyd(&sorted, split(&sorted));
    let mut codebook: Vec<f32> = means.iter().map(|&mean| mean as f32).collect();
    let last = codebook.last().copied().unwrap_or(0.0);
    codebook.resize(LEVELS, last);
    let borders: Vec<f32> = codebook.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
    let indices = values.par_iter().map(|value| borders.partition_point(|border| border < value) as u8).collect();
    Quantised { codebook, indices }
}

#[derive(Clone, Copy)]
struct ValueCell {
    begin: usize,
    end: usize,
    mean: f64,
    /// Sum of the squared differences from the mean.
    error: f64,
}

impl ValueCell {
    fn of(sorted: &[f32], begin: usize, end: usize) -> Self {
        let values = &sorted[begin..end];
        // Sums of pieces, in order: the number of threads does not change them.
        let sum = |of: &(dyn Fn(f64) -> f64 + Sync)| -> f64 {
            let pieces: Vec<f64> =
                values.par_chunks(1 << 16).map(|piece| piece.iter().map(|&v| of(f64::from(v))).sum()).collect();
            pieces.iter().sum()
        };
        let mean = sum(&|value| value) / values.len().max(1) as f64;
        // The mean of equal values may be beside them by a rounding.
        let mean = mean.clamp(f64::from(sorted[begin]), f64::from(sorted[end - 1]));
        let error = if sorted[begin] == sorted[end - 1] { 0.0 } else { sum(&|value| (value - mean) * (value - mean)) };
        Self { begin, end, mean, error }
    }
}

/// Splits sorted values into at most 256 cells. Returns their means.
fn split(sorted: &[f32]) -> Vec<f64> {
    if sorted.is_empty() {
        return Vec::new();
    }
    let mut cells = vec![ValueCell::of(sorted, 0, sorted.len())];
    while cells.len() < LEVELS {
        let largest = (0..cells.len()).max_by(|&a, &b| cells[a].error.total_cmp(&cells[b].error)).unwrap_or(0);
        let ValueCell { begin, end, mean, error } = cells[largest];
        if !(error > 0.0) {
            break;
        }
        let middle = begin + sorted[begin..end].partition_point(|&value| f64::from(value) <= mean);
        // A mean that rounds to the largest value leaves nothing above it.
        let middle = middle.min(end - 1);
        cells[largest] = ValueCell::of(sorted, begin, middle);
        cells.push(ValueCell::of(sorted, middle, end));
    }
    cells.sort_unstable_by_key(|cell| cell.begin);
    cells.iter().map(|cell| cell.mean).collect()
}

fn lloyd(sorted: &[f32], mut means: Vec<f64>) -> Vec<f64> {
    for _ in 0..ITERATIONS {
        let borders: Vec<usize> = means
            .windows(2)
            .map(|pair| sorted.partition_point(|&value| f64::from(value) <= 0.5 * (pair[0] + pair[1])))
            .collect();
        let ends: Vec<usize> = borders.into_iter().chain([sorted.len()]).collect();
        let begins = [0].into_iter().chain(ends.iter().copied());
        let cells: Vec<(usize, usize)> = begins.zip(ends.iter().copied()).collect();
        means = (cells.into_par_iter().zip(&means))
            .map(|((begin, end), &mean)| match begin < end {
                true => sorted[begin..end].iter().map(|&value| f64::from(value)).sum::<f64>() / (end - begin) as f64,
                false => mean,
            })
            .collect();
    }
    means
}

#[cfg(test)]
mod tests;
