//! What can stop a run.

use splat_op::SplatError;
use thiserror::Error;

use super::{Resolution, Stage};
use crate::effects::screen::ScreenError;
use crate::gaussians::RowsError;

/// Why a run cannot start or go on.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrainError {
    /// No photographs.
    #[error("there are no photographs to train on: with every photograph in the test split, raise `--eval-every`")]
    NoViews,
    /// Steps of zero.
    #[error("`steps` is 0, expected at least 1: give `--steps N`")]
    NoSteps,
    /// Steps without photographs.
    #[error("`batch` is 0, expected at least 1: give `--batch N`")]
    NoBatch,
    /// More degrees than there are.
    #[error("`sh_degree` is {0}, expected 0 to 4")]
    ShDegree(usize),
    /// A variation of colours that is none.
    #[error("`matte_below` is {0}, expected a finite number of at least 0: see `--matte-below`")]
    MatteBelow(f64),
    /// More degrees than there are, behind the scene.
    #[error("the degree of `backdrop.environment` is {0}, expected 0 to 4")]
    EnvironmentDegree(usize),
    /// Sizes of photographs that are none.
    #[error(
        "`resolution` is {} from {}, expected a power of two up to {} and a share from 0 to 1: see `--coarsest` and `--full-from`",
        .0.coarsest_divisor, .0.full_from, Resolution::DIVISOR_MAX
    )]
    Resolution(Resolution),
    /// A background is to be learnt from a photograph that was cut out.
    #[error(
        "photograph `{0}` has transparent parts and says nothing of a background to learn: train with `--effects=-alpha` \
         to take photographs as opaque, or without learning a background"
    )]
    LearntBackground(String),
    /// A rolling shutter or an open aperture before a lens.
    #[error("{0}. Motion blur alone can be simulated for it; train without `rolling-shutter` and `defocus`")]
    Screen(#[from] ScreenError),
    /// The operation refused its inputs.
    #[error(transparent)]
    Op(#[from] SplatError),
    /// Rows that do not fit together.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// A loss or gradient that is not finite. The scene is as it was before the step.
    #[error(
        "step {step}, photograph `{view}`: {what} is not finite, so the step was not taken and the run ends. Train with \
         `--check` to learn which stage goes wrong first"
    )]
    NonFinite {
        /// Counted from 1.
        step: usize,
        /// The photograph's name.
        view: String,
        /// The loss, or the gradient of which parameters.
        what: String,
    },
    /// A stage left what it must not (see [`Trainer::with_checks`]).
    #[error("step {step}, photograph `{view}`: the stage `{stage}` is the first to go wrong: {detail}")]
    Check {
        /// Counted from 1.
        step: usize,
        /// The photograph's name.
        view: String,
        /// The stage.
        stage: Stage,
        /// The field, the place, what was found and what was expected.
        detail: String,
    },
}

impl TrainError {
    /// Whether the run went wrong after it began, with a scene worth keeping as it was before the step.
    pub fn keeps_scene(&self) -> bool {
        matches!(self, Self::NonFinite { .. } | Self::Check { .. })
    }
}
