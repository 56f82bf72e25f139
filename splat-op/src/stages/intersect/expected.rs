//! Expected numbers of intersections, from recent views. A view's lists are sized by them before its own number is known. A
//! wrong expectation costs time and memory, and changes no result.

use std::sync::{Mutex, PoisonError};

use crate::gpu::roomy;

/// What recent views of one size of pictures needed.
#[derive(Clone, Copy)]
struct Recent {
    tiles: [usize; 2],
    gaussians: u64,
    intersections: u64,
}

/// Number of sizes of pictures that are remembered, the latest last.
const SIZES: usize = 16;

/// All devices share it.
static RECENT: Mutex<Vec<Recent>> = Mutex::new(Vec::new());

/// Largest factor between the numbers of Gaussians of views that tell of each other.
const LIKE: u64 = 2;

/// The part of what earlier views needed that each later view forgets is one in this number.
const FORGOTTEN: u64 = 64;

/// The expected number with headroom: a sixteenth more, and all that memory of [`roomy`] size holds.
fn with_headroom(expected: u64) -> u64 {
    roomy((expected + expected / 16 + 1) as usize) as u64
}

impl Recent {
    /// What is expected with another number of Gaussians. `None` if it differs too much.
    fn scaled_to(&self, gaussians: u64) -> Option<u64> {
        let like = gaussians <= LIKE * self.gaussians && self.gaussians <= LIKE * gaussians && gaussians > 0;
        like.then(|| self.intersections.saturating_mul(gaussians) / self.gaussians)
    }
}

/// Returns the number of intersections that the lists of a view should hold; `None` if no recent view is like it.
pub(super) fn expected(tiles: [usize; 2], gaussians: usize) -> Option<u64> {
    let recent = RECENT.lock().unwrap_or_else(PoisonError::into_inner);
    let like = recent.iter().find(|recent| recent.tiles == tiles)?;
    like.scaled_to(gaussians as u64).map(with_headroom)
}

/// Remembers what a view needed.
pub(super) fn remember(tiles: [usize; 2], gaussians: usize, intersections: u64) {
    let mut recent = RECENT.lock().unwrap_or_else(PoisonError::into_inner);
    let gaussians = gaussians as u64;
    let at = recent.iter().position(|recent| recent.tiles == tiles);
    let before = at.and_then(|at| recent.remove(at).scaled_to(gaussians)).unwrap_or(0);
    if recent.len() == SIZES {
        recent.remove(0);
    }
    recent.push(Recent { tiles, gaussians, intersections: intersections.max(before - before / FORGOTTEN) });
}

#[cfg(test)]
mod tests;
