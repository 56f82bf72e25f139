//! What can stop a run.

use splat_op::{CameraModel, SplatError};
use thiserror::Error;

use super::{Resolution, Stage};
use crate::capture::CaptureError;
use crate::effects::screen::ScreenError;
use crate::gaussians::RowsError;
use crate::state::StateError;

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
    /// More degrees than there are, behind the scene.
    #[error("the degree of `backdrop.environment` is {0}, expected 0 to 4")]
    EnvironmentDegree(usize),
    /// Sizes of photographs that are none.
    #[error(
        "`resolution` is {} from {}, expected a power of two up to {} and a share from 0 to 1: see `--coarsest` and `--full-from`",
        .0.coarsest_divisor, .0.full_from, Resolution::DIVISOR_MAX
    )]
    Resolution(Resolution),
    /// Rays, for what changes ellipses.
    #[error(
        "{optics} change ellipses on the screen, and with {rays} there are none: leave out one of them (`--effects=-NAME`)"
    )]
    Ellipses {
        /// The model choices.
        rays: &'static str,
        /// The effects.
        optics: &'static str,
    },
    /// Rays through a lens.
    #[error(
        "photograph `{photo}` was taken through a lens ({model:?}), and `--projection exact` and `--order per-pixel` are for \
         pinholes, whose pixels see straight rays of one origin: undistort the photographs, or leave out both"
    )]
    Lens {
        /// Its name.
        photo: String,
        /// Its camera.
        model: CameraModel,
    },
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
    /// A photograph cannot be decoded again.
    #[error(transparent)]
    Photograph(#[from] CaptureError),
    /// What was kept of a run is not what this one needs.
    #[error("what was kept of the run does not fit to it: {0}")]
    State(#[from] StateError),
    /// What was kept is of another run.
    #[error(
        "{what} is {found}, and was {expected} when the run was kept: give it back what it had, or start the run anew"
    )]
    OtherRun {
        /// The option or photograph.
        what: String,
        /// Of this run.
        found: String,
        /// Of the one that was kept.
        expected: String,
    },
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
    /// A stage left what it must not (see [`with_checks`](super::Trainer::with_checks)).
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
        matches!(self, Self::NonFinite { .. } | Self::Check { .. } | Self::Photograph(_))
    }
}
