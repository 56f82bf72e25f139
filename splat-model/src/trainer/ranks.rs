//! A run of several processes, called ranks, each of which renders its part of a batch.
//!
//! Every rank holds the whole scene and all state of the run, and takes the same steps. A rank renders consecutive views of
//! each batch. Gradients are summed in the order of views, as one process sums them: `((g₀ + g₁) + g₂) + …`. Sums in f32 depend
//! on their order, so any number of ranks gives the bits of one process on CPUs.
//!
//! [`Ranks`] is all that a run needs from the outside. [`Alone`] is a run of one process. `splat train` has one over MPI.

use std::ops::Range;

use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use super::{Result, TrainError};

/// A connection between ranks that no longer works.
#[derive(Debug, Error)]
#[error("rank {rank} cannot go on with the others: {reason}")]
pub struct RankError {
    /// The rank that noticed.
    pub rank: usize,
    /// The reason.
    pub reason: String,
}

/// The ranks of a run, as one of them sees them. All but [`Self::rank`] and [`Self::count`] are collective: every rank calls
/// the same functions in the same order.
pub trait Ranks {
    /// Number of this rank, counted from 0.
    fn rank(&self) -> usize;

    /// Number of ranks.
    fn count(&self) -> usize;

    /// The messages of all ranks, in order of ranks. They may differ in length.
    ///
    /// # Errors
    /// If another rank is gone.
    fn gather(&self, own: &[u8]) -> Result<Vec<Vec<u8>>, RankError>;

    /// Replaces `values` by those of the rank `from`. They have the same length on all ranks.
    ///
    /// # Errors
    /// If another rank is gone.
    fn copy(&self, from: usize, values: &mut [f32]) -> Result<(), RankError>;

    /// The sum of all `parts`, of `count` numbers each: `((p₀ + p₁) + p₂) + …` in order of ranks, and of each rank's parts, rounded
    /// to f32 after each addition. `parts_of[r]` is the number of parts of rank `r`; one rank has a part at least. [`add`] adds one.
    ///
    /// # Errors
    /// If another rank is gone.
    fn sum(&self, parts: Vec<Vec<f32>>, parts_of: &[usize], count: usize) -> Result<Vec<f32>, RankError>;
}

/// The only process of a run.
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn gather(&self, own: &[u8]) -> Result<Vec<Vec<u8>>, RankError> {
        Ok(vec![own.to_vec()])
    }

    fn copy(&self, _: usize, _: &mut [f32]) -> Result<(), RankError> {
        Ok(())
    }

    fn sum(&self, parts: Vec<Vec<f32>>, _: &[usize], count: usize) -> Result<Vec<f32>, RankError> {
        let sum = parts.into_iter().reduce(|mut sum, part| {
            add(&mut sum, &part);
            sum
        });
        Ok(sum.unwrap_or_else(|| vec![0.0; count]))
    }
}

/// Adds `part` to `sum`, number by number.
pub fn add(sum: &mut [f32], part: &[f32]) {
    // 64 KiB of each, as in Adam's steps.
    const CHUNK: usize = 16_384;
    sum.par_chunks_mut(CHUNK).zip(part.par_chunks(CHUNK)).for_each(|(sum, part)| {
        sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
    });
}

/// The part of a batch, or of another list of `count` items, that belongs to a rank. The first ranks have one item more where
/// the parts cannot be equal.
pub fn share_of(rank: usize, ranks: usize, count: usize) -> Range<usize> {
    (rank * count).div_ceil(ranks)..((rank + 1) * count).div_ceil(ranks)
}

/// The values of all ranks, in order of ranks.
///
/// # Errors
/// If another rank is gone, or sent something else.
pub fn gather_all<T: Serialize + DeserializeOwned>(ranks: &dyn Ranks, own: &T) -> Result<Vec<T>, RankError> {
    let lost = |reason: serde_json::Error| RankError { rank: ranks.rank(), reason: reason.to_string() };
    let messages = ranks.gather(&serde_json::to_vec(own).map_err(lost)?)?;
    messages.iter().map(|message| serde_json::from_slice(message).map_err(lost)).collect()
}

/// Something that is the same on all ranks of a run, such as an option: its name, and its value for people.
pub type Fact = (String, String);

/// Compares facts, in order, with those of rank 0. All ranks return the same error.
///
/// # Errors
/// [`TrainError::RanksDiffer`] for the first fact of the first rank that differs.
pub fn agree(ranks: &dyn Ranks, facts: &[Fact]) -> Result<()> {
    match first_difference(ranks, facts)? {
        None => Ok(()),
        Some((rank, what, found, expected)) => Err(TrainError::RanksDiffer { rank, what, found, expected }),
    }
}

/// The first rank that differs from rank 0, with the fact and both values.
pub(super) fn first_difference(
    ranks: &dyn Ranks,
    facts: &[Fact],
) -> Result<Option<(usize, String, String, String)>, RankError> {
    let all: Vec<Vec<Fact>> = gather_all(ranks, &facts.to_vec())?;
    let none = Fact::default();
    for (rank, found) in all.iter().enumerate().skip(1) {
        for i in 0..found.len().max(all[0].len()) {
            let (found, expected) = (found.get(i).unwrap_or(&none), all[0].get(i).unwrap_or(&none));
            if found != expected {
                let what = if expected.0.is_empty() { &found.0 } else { &expected.0 };
                let value = |fact: &Fact| if fact.0 == *what { fact.1.clone() } else { "missing".into() };
                return Ok(Some((rank, what.clone(), value(found), value(expected))));
            }
        }
    }
    Ok(None)
}

#[cfg(test)]
pub(super) mod testing;
#[cfg(test)]
mod tests;
