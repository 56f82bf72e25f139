//! The split into training and test views.

use super::{Capture, CaptureError, View};

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

    /// Holds out the views at index 0, `k`, 2`k`, … in order of name; `k` = 0 holds out none.
    ///
    /// `k` = 8 is the split of papers since Mip-NeRF 360 (Barron et al. 2022).
    pub fn every(views: &[View], k: usize) -> Self {
        let mut by_name: Vec<usize> = (0..views.len()).collect();
        by_name.sort_by(|&a, &b| views[a].name.cmp(&views[b].name));
        let mut split = Self::default();
        for (rank, view) in by_name.into_iter().enumerate() {
            let held_out = k > 0 && rank % k == 0;
            if held_out { &mut split.test } else { &mut split.train }.push(view);
        }
        split
    }

    /// The views to train on.
    ///
    /// # Errors
    ///
    /// [`CaptureError::NoTrainingViews`] if there are none.
    pub fn require_train(&self) -> Result<&[usize], CaptureError> {
        match self.train.is_empty() {
            true => Err(CaptureError::NoTrainingViews { views: self.test.len() }),
            false => Ok(&self.train),
        }
    }

    /// The views held out.
    ///
    /// # Errors
    ///
    /// [`CaptureError::NoTestViews`] if there are none.
    pub fn require_test(&self) -> Result<&[usize], CaptureError> {
        match self.test.is_empty() {
            true => Err(CaptureError::NoTestViews { views: self.train.len() }),
            false => Ok(&self.test),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use glam::DAffine3;
    use splat_op::Intrinsics;

    use super::*;

    fn views(names: &[&str]) -> Vec<View> {
        let view = |name: &&str| View {
            name: name.to_string(),
            image_path: PathBuf::from(name),
            intrinsics: Intrinsics::centred(4, 3, 5.0),
            cam_from_world: DAffine3::IDENTITY,
        };
        names.iter().map(view).collect()
    }

    #[test]
    fn every_third_by_name_is_held_out() {
        let split = Split::every(&views(&["e", "d", "c", "b", "a"]), 3);
        assert_eq!(split.test, [4, 1], "ranks 0 and 3 by name");
        assert_eq!(split.train, [3, 2, 0]);
    }

    #[test]
    fn zero_holds_out_none_and_says_what_to_do() {
        let split = Split::every(&views(&["a", "b"]), 0);
        assert_eq!(split.require_train().unwrap(), [0, 1]);
        let message = split.require_test().unwrap_err().to_string();
        assert!(message.contains("--test-every") && message.contains("2 views"), "{message}");
    }

    #[test]
    fn one_leaves_nothing_to_train_on_and_says_what_to_do() {
        let split = Split::every(&views(&["a", "b"]), 1);
        assert_eq!(split.require_test().unwrap(), [0, 1]);
        let message = split.require_train().unwrap_err().to_string();
        assert!(message.contains("--test-every") && message.contains("2 views"), "{message}");
    }

    #[test]
    fn one_photograph_is_told_what_helps() {
        let split = Split::every(&views(&["a"]), 8);
        let message = split.require_train().unwrap_err().to_string();
        assert!(message.contains("the 1 view is held out") && message.contains("`--test-every 0`"), "{message}");
        assert!(!message.contains("8"), "{message}");
    }

    #[test]
    fn no_views_at_all_is_an_error_both_ways() {
        let split = Split::every(&[], 8);
        assert!(split.require_train().is_err() && split.require_test().is_err());
    }
}
