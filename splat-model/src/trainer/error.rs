//! Errors of a run.

use splat_op::{CameraModel, SplatError};
use thiserror::Error;

use super::Resolution;
use super::ranks::RankError;
use crate::capture::{CaptureError, PointsSeen};
use crate::gaussians::RowsError;
use crate::state::StateError;

/// A result, or the reason why a run cannot start or continue.
pub type Result<T, E = TrainError> = std::result::Result<T, E>;

/// The reason why a run cannot start or continue.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrainError {
    /// No photographs.
    #[error("there are no photographs to train on: with every photograph in the test split, raise `--test-every`")]
    NoViews,
    /// `steps` is zero.
    #[error("`steps` is 0, expected at least 1: give `--steps N`")]
    NoSteps,
    /// An option is out of range or does not fit another.
    #[error("{0}")]
    Option(String),
    /// The schedule of the photographs' size is out of range.
    #[error(
        "`resolution` is {} from {}, expected a power of two up to {} and a share from 0 to 1: see `--coarsest`",
        .0.coarsest_divisor, .0.full_from, Resolution::DIVISOR_MAX
    )]
    Resolution(Resolution),
    /// A background cannot be learned from a photograph with transparent parts.
    #[error(
        "photograph `{0}` has transparent parts, which do not show a background to learn: train with `--effects=-alpha` \
         to take photographs as opaque, or without learning a background"
    )]
    LearntBackground(String),
    /// A rolling shutter with a lens.
    #[error(
        "the camera model is {0:?}, and rolling shutters are simulated for Pinhole only: undistort the photographs, or train \
         without `rolling-shutter`"
    )]
    Optics(CameraModel),
    /// The render operation rejected its inputs.
    #[error(transparent)]
    Op(#[from] SplatError),
    /// The rows are inconsistent.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// A photograph cannot be decoded.
    #[error(transparent)]
    Photograph(#[from] CaptureError),
    /// The saved state does not fit this run.
    #[error("the saved state does not fit the run: {0}")]
    State(#[from] StateError),
    /// The saved state belongs to another run.
    #[error("{what} is {found}, and was {expected} in the saved run: restore the old value, or start a new run")]
    OtherRun {
        /// Name of the option or photograph.
        what: String,
        /// Value of this run.
        found: String,
        /// Value of the saved run.
        expected: String,
    },
    /// Density control removed the last Gaussian.
    #[error("step {step}: no splat is left, so the run ends: {}", .seen.unseen_said())]
    NoSplats {
        /// Number of the step, counted from 1.
        step: usize,
        /// The points that the run started from.
        seen: PointsSeen,
    },
    /// A loss or gradient is not finite. The scene keeps its state before the step.
    #[error(
        "step {step}, photograph `{view}`: {what} is not finite, so the step was not taken and the run ends; {stage}"
    )]
    NonFinite {
        /// Number of the step, counted from 1.
        step: usize,
        /// The photograph's name.
        view: String,
        /// The loss, or the names of the parameters with non-finite gradients.
        what: String,
        /// The stage of the render that goes wrong first, or that none does.
        stage: String,
    },
    /// Another rank of the run failed. The scene keeps its state before the step.
    #[error("rank {rank}: {message}")]
    OtherRank {
        /// Number of the rank.
        rank: usize,
        /// Its error.
        message: String,
    },
    /// A rank was started with something else than rank 0.
    #[error(
        "{what} is {found} on rank {rank}, and {expected} on rank 0: start all ranks with the same program, options and capture"
    )]
    RanksDiffer {
        /// Number of the rank.
        rank: usize,
        /// The difference.
        what: String,
        /// Value of the rank.
        found: String,
        /// Value of rank 0.
        expected: String,
    },
    /// A rank has come to another state than rank 0.
    #[error(
        "after step {step}, {what} of rank {rank} is not that of rank 0. Ranks need processors of one kind, whose arithmetic is the \
         same to the bit; an effect of your own has to list its parameters in `Effect::leaves`"
    )]
    Apart {
        /// Number of the step, counted from 1.
        step: usize,
        /// Number of the rank.
        rank: usize,
        /// Name of the entry in the saved state.
        what: String,
    },
    /// The ranks are no longer connected.
    #[error(transparent)]
    Ranks(#[from] RankError),
}

impl TrainError {
    /// Whether the run failed after its start and the scene before the failed step can be saved.
    pub fn keeps_scene(&self) -> bool {
        matches!(self, Self::NonFinite { .. } | Self::Photograph(_) | Self::OtherRank { .. })
    }
}
