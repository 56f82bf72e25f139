//! The photographs and points of a block.

use std::collections::BTreeSet;

use rayon::prelude::*;

use super::Block;
use super::cut::Cell;
use crate::capture::{Capture, Split};

/// Largest number of points whose projections say what a capture without tracks shows.
const PROJECTED: usize = 20_000;

/// Least number of photographs to train a block on, where there are as many that see any of it.
const LEAST_PHOTOGRAPHS: usize = 8;

/// Largest number of points beyond the region, relative to those within it.
const BEYOND: f64 = 0.25;

/// The points that each view shows.
pub(super) struct PointsByView {
    /// Points, ascending, for each view.
    pub by_view: Vec<Vec<u32>>,
    /// Distance between the points that were looked at: 1 with tracks.
    step: usize,
}

impl PointsByView {
    pub fn of(capture: &Capture) -> Self {
        let count = if capture.tracks.observations() > 0 { 0 } else { capture.points.positions.len() };
        let step = count.div_ceil(PROJECTED).max(1);
        Self { by_view: capture.shown(&(0..capture.views.len()).collect::<Vec<_>>(), step), step }
    }
}

/// Chooses what a block trains on.
pub(super) fn block(capture: &Capture, split: &Split, seen: &PointsByView, cell: Cell, min_share: f64) -> Block {
    let Cell { cell, region } = cell;
    let count = capture.points.positions.len();
    let within: Vec<bool> = (0..count).into_par_iter().map(|i| region.contains(capture.position(i))).collect();
    let points_in_cell = (0..count).filter(|&point| cell.contains(capture.position(point))).count();
    let all = (0..count).step_by(seen.step).filter(|&point| within[point]).count();
    // How much of the block each view sees, and how much of the view the block fills; the larger counts.
    let share = |&view: &usize| {
        let of_view = &seen.by_view[view];
        let both = of_view.iter().filter(|&&point| within[point as usize]).count();
        let ratio = |of: usize| both as f64 / of.max(1) as f64;
        ratio(all).max(ratio(of_view.len()))
    };
    let chosen = |views: &[usize], least: usize| {
        let mut shares: Vec<(f64, usize)> =
            views.iter().map(|view| (share(view), *view)).filter(|(share, _)| *share > 0.0).collect();
        shares.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let enough = shares.iter().take_while(|(share, _)| *share >= min_share).count();
        let mut views: Vec<usize> = shares.iter().take(enough.max(least)).map(|(_, view)| *view).collect();
        views.sort_unstable();
        views
    };
    let (train, test) = (chosen(&split.train, LEAST_PHOTOGRAPHS), chosen(&split.test, 1));
    let beyond: BTreeSet<u32> = (train.iter().flat_map(|&view| &seen.by_view[view]).copied())
        .filter(|&point| !within[point as usize])
        .collect();
    let inside = within.iter().filter(|&&inside| inside).count();
    let most = ((BEYOND * inside as f64) as usize).max(1);
    let thinned = beyond.iter().step_by(beyond.len().div_ceil(most).max(1)).map(|&point| point as usize);
    let mut points: Vec<usize> = (0..count).filter(|&point| within[point]).chain(thinned).collect();
    points.sort_unstable();
    Block { cell, region, train, test, points, points_in_cell }
}
