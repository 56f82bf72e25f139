//! The interface of density control strategies, which decide how many Gaussians a run has and where.
//!
//! A custom strategy is a type that implements [`Strategy`] and is passed to
//! [`Trainer::with_strategy`](crate::trainer::Trainer::with_strategy). `train/examples/own_program.rs` has a complete one.

use burn::tensor::{Device, Int, Tensor};
use rand::Rng;
use splat_op::Splats;

use super::rows::Trained;
use crate::gaussians::{GaussianRows, RowsError};
use crate::state::{State, StateError};

/// The signals of a step that a strategy needs. Other signals are not computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    /// The gradient at the projected centres (Kerbl et al. 2023, section 5.2).
    pub gradient: bool,
    /// The gradient at the projected centres as a sum of absolute values over the pixels (AbsGS, Ye et al. 2024, eq. 7), so
    /// that the gradients of two edges of a Gaussian that is too large do not cancel.
    pub abs_gradient: bool,
}

/// The requested signals of one view. Each view of a batch has its own.
#[derive(Clone, Debug, Default)]
pub struct Observed {
    /// `[N, 2]`: `∂L/∂mean2d`, per px.
    pub gradient: Option<Tensor<2>>,
    /// `[N, 2]`: `Σ |∂L/∂mean2d|` over the pixels, per px.
    pub abs_gradient: Option<Tensor<2>>,
    /// Width and height of the picture, px.
    pub size: (usize, usize),
}

/// The position in a run at which a strategy acts.
#[derive(Clone, Copy, Debug)]
pub struct StrategyContext<'a> {
    /// Number of the step, counted from 1.
    pub step: usize,
    /// Number of steps in the whole run.
    pub steps: usize,
    /// See [`crate::optim::scene_extent`], scene units.
    pub extent: f64,
    /// The centres' learning rate in this step, scene units.
    pub means_rate: f64,
    /// `[2]`: on a GPU, the device's verdict on this and earlier steps. Nothing may change if a step is recorded in it (see
    /// [`splat_op::adam`]). At steps of [`Strategy::acts_at`] it has been read already, and no step is recorded.
    pub verdict: Option<&'a Tensor<1, Int>>,
}

/// The changes of a refinement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RefineReport {
    /// Gaussians copied.
    pub cloned: usize,
    /// Large Gaussians split in two.
    pub split: usize,
    /// Gaussians removed.
    pub pruned: usize,
    /// Gradient threshold of the refinement, which at the cap exceeds the configured one. 0 if the strategy has none.
    pub threshold: f64,
}

/// What [`Strategy::act`] returns.
pub type Refined = Result<Option<RefineReport>, RowsError>;

/// A strategy of density control. The trainer calls the functions in the order below.
///
/// All randomness must come from the generator that is passed in, and all state must be saved, so that a run can be
/// repeated exactly, interrupted or not.
pub trait Strategy {
    /// Changes the initial Gaussians before training.
    fn start(&mut self, _rows: &mut GaussianRows) {}

    /// The signals that the strategy needs at `step`, counted from 1.
    fn listens_at(&self, _step: usize) -> Signals {
        Signals::default()
    }

    /// Returns a term to add to the loss of `step`, `[1]`, tracked. `splats` are the activated parameters.
    fn penalty(&self, _splats: &Splats, _step: usize) -> Option<Tensor<1>> {
        None
    }

    /// Receives the requested signals, before the optimiser step.
    fn observe(&mut self, _seen: Observed) {}

    /// Whether [`Self::act`] reads the scene at `step`, or adds, removes or moves rows. The trainer then waits for the device.
    fn acts_at(&self, step: usize) -> bool;

    /// Changes the scene after the optimiser step. Called at every step. Returns a report if rows were added, removed, moved or replaced.
    ///
    /// # Errors
    /// If the rows of the scene are inconsistent.
    fn act(&mut self, scene: &mut Trained, at: &StrategyContext, rng: &mut dyn Rng) -> Refined;

    /// Informs the strategy that the run will have `steps` steps, for one that reads the number before [`Self::act`] tells it.
    fn set_steps(&mut self, _steps: usize) {}

    /// Saves the strategy's state.
    ///
    /// # Errors
    /// If a value cannot be stored in a state.
    fn save(&self, _to: &mut State) -> Result<(), StateError> {
        Ok(())
    }

    /// Restores what [`Self::save`] saved. `device` is the scene's device without autodiff.
    ///
    /// # Errors
    /// If a value is missing or invalid.
    fn load(&mut self, _from: &mut State, _device: &Device) -> Result<(), StateError> {
        Ok(())
    }
}
