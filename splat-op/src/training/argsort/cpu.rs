//! The CPU twin of the sort.

use rayon::prelude::*;

/// Returns the rows by key; rows of equal keys keep their order.
pub(crate) fn argsort_cpu(keys: impl Iterator<Item = u32>) -> Vec<i32> {
    // A pair is one number, and no two are equal, so that an unstable sort has one result.
    let mut pairs: Vec<u64> = keys.zip(0..).map(|(key, row): (u32, u64)| u64::from(key) << 32 | row).collect();
    pairs.par_sort_unstable();
    pairs.into_iter().map(|pair| pair as u32 as i32).collect()
}
