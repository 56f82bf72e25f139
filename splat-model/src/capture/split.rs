//! The split into training and test views.

use super::{Capture, CaptureError, Result, View};

/// Indices into a list of views, in order of name. No view is listed twice. A view that a capture's own split leaves out, such as
/// a validation photograph where there are test photographs, is in neither list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// Views to train on.
    pub train: Vec<usize>,
    /// Views held out, to measure quality on.
    pub test: Vec<usize>,
}

impl Split {
    /// The default interval: every eighth photograph is held out, as in papers since Mip-NeRF 360 (Barron et al. 2022).
    pub const USUAL: usize = 8;

    /// The split of a capture: [`every`](Self::every) `k`th view held out if `k` is given; otherwise the capture's own split,
    /// or every [eighth](Self::USUAL) view if it has none.
    pub fn of(capture: &Capture, k: Option<usize>) -> Self {
        match (k, &capture.split) {
            (None, Some(own)) => own.clone(),
            _ => Self::every(&capture.views, k.unwrap_or(Self::USUAL)),
        }
    }

    /// Holds out the photographs at index 0, `k`, 2`k`, … in order of name, a panorama with all its views; `k` = 0 holds out none.
    ///
    /// `k` = 8 is the split of papers since Mip-NeRF 360 (Barron et al. 2022).
    pub fn every(views: &[View], k: usize) -> Self {
        let mut by_name: Vec<usize> = (0..views.len()).collect();
        by_name.sort_by(|&a, &b| views[a].photograph().cmp(views[b].photograph()));
        let mut split = Self::default();
        let photographs = by_name.chunk_by(|&a, &b| views[a].photograph() == views[b].photograph());
        for (rank, photograph) in photographs.enumerate() {
            let held_out = k > 0 && rank % k == 0;
            if held_out { &mut split.test } else { &mut split.train }.extend(photograph);
        }
        split
    }

    /// The views to train on.
    ///
    /// # Errors
    /// If there are none.
    pub fn require_train(&self) -> Result<&[usize]> {
        if !self.train.is_empty() {
            return Ok(&self.train);
        }
        let train_on = if self.test.len() > 1 { "all, or 8 to hold out every eighth" } else { "it" };
        Err(CaptureError::Content(format!(
            "{} held out for testing and none is for training, expected at least one. Set `--test-every 0` to train on {train_on}, or add \
             photographs",
            all(self.test.len())
        )))
    }

    /// The views held out.
    ///
    /// # Errors
    /// If there are none.
    pub fn require_test(&self) -> Result<&[usize]> {
        if !self.test.is_empty() {
            return Ok(&self.test);
        }
        let fix = match self.train.len() {
            0 | 1 => "Add photographs",
            _ => "Set `--test-every` to 8, say, to hold out every eighth",
        };
        let all = all(self.train.len());
        Err(CaptureError::Content(format!(
            "{all} for training and none is held out for testing, expected at least one. {fix}"
        )))
    }
}

/// The beginning of a sentence about so many views.
fn all(views: usize) -> String {
    if views == 1 { "the 1 view is".into() } else { format!("all {views} views are") }
}

#[cfg(test)]
mod tests;
