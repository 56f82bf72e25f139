//! The CPU twin of the sort.

use rayon::prelude::*;

/// Returns the rows by key; rows of equal keys keep their order.
pub(crate) fn argsort_cpu(keys: impl IndexedParallelIterator<Item = u32>) -> Vec<i32> {
    // A pair is one number, and no two are equal, so that an unstable sort has one result.
    let mut pairs: Vec<u64> = keys.enumerate().map(|(row, key)| u64::from(key) << 32 | row as u64).collect();
    pairs.par_sort_unstable();
    pairs.into_iter().map(|pair| pair as u32 as i32).collect()
}
