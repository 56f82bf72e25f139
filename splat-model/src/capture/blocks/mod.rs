//! Blocks: parts of a capture that are trained on their own and merged afterwards.
//!
//! [`plan`] cuts a capture into [cells](Bounds) and chooses the photographs and points of each; [`BlockFile::write`] makes a folder
//! of it, which [`Capture::load`] reads as a capture. Cells divide the whole of space. A Gaussian belongs to the
//! cell that holds it, and to several by its share in each where it reaches across a border ([`keep`]).
//!
//! A block trains on more than its cell. Its *region* is the cell with a margin, within which Gaussians are added freely. Beyond it
//! lie the sparse points that its photographs show, thinned: without them, Gaussians of the block would grow to explain what lies
//! behind it. A density strategy limits how many Gaussians they become. After training only the cell is kept.

mod bounds;
mod cut;
mod file;
mod merge;
mod share;
#[cfg(test)]
mod tests;

use thiserror::Error;

pub use self::bounds::Bounds;
pub use self::file::{BLOCK, BlockFile};
pub(super) use self::file::{is_there, load};
pub use self::merge::keep;
use super::{Capture, Split};

options! {
    /// Options of [`plan`].
    #[derive(Copy)]
    pub struct BlockOptions {
        /// Number of blocks, at least 1.
        pub blocks: usize = 1,
        /// Width of the margin around a cell, as a share of the cell's size along each axis: 0.05.
        pub margin: f64 = 0.05,
        /// Least share of a block's points that a photograph sees, or else of its own points that lie in the block: 0.1.
        pub min_share: f64 = 0.1,
    }
}

/// A part of a capture. Lists are in ascending order.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// What it keeps after training.
    pub cell: Bounds,
    /// The cell with its margin.
    pub region: Bounds,
    /// Views to train on.
    pub train: Vec<usize>,
    /// Views held out.
    pub test: Vec<usize>,
    /// Points: all in the region, and some of those beyond it that the training views show.
    pub points: Vec<usize>,
    /// Number of points in the cell.
    pub points_in_cell: usize,
}

/// A capture that cannot be cut: what was found, what was expected and what to do.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct BlockError(String);

/// Divides a capture with this split into blocks.
///
/// Cells are cut by planes that are upright as the cameras are, at right angles: of the cells that have to become several, each is cut
/// across its longer side such that the weight on each side is in proportion to its number of blocks. Every point weighs the same. The
/// cameras together weigh a third of the points, so that a cell has work for its share of the time.
///
/// A photograph goes to each block of which it sees enough, and to each block that fills enough of it
/// ([`BlockOptions::min_share`]). What it sees follows from the tracks, or from projecting the points where there are none. Held-out
/// photographs remain held out in every block.
///
/// # Errors
/// If the capture has no points, or they cannot be divided.
pub fn plan(capture: &Capture, split: &Split, options: &BlockOptions) -> Result<Vec<Block>, BlockError> {
    if options.blocks == 0 {
        return Err(BlockError("a plan of 0 blocks, expected at least one".into()));
    }
    if capture.points.positions.is_empty() {
        let found = "the capture has no sparse points, by which blocks are cut: reconstruct it with COLMAP, or train it as a whole";
        return Err(BlockError(found.into()));
    }
    let cells = cut::cells(capture, options.blocks, options.margin)?;
    let seen = share::PointsByView::of(capture);
    if split.train.iter().all(|&view| seen.by_view[view].is_empty()) {
        let found = "no training photograph shows a sparse point: check that the points belong to the photographs";
        return Err(BlockError(found.into()));
    }
    Ok(cells.into_iter().map(|cell| share::block(capture, split, &seen, cell, options.min_share)).collect())
}
