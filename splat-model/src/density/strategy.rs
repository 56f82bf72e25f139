//! What a strategy of density control is: a run's policy on how many Gaussians there are, and where.
//!
//! A strategy of your own is one type that implements [`Strategy`], handed to
//! [`Trainer::with_strategy`](crate::trainer::Trainer::with_strategy); `examples/custom_strategy.rs` is a whole one.

use burn::tensor::{Device, Int, Tensor};
use rand::Rng;
use splat_op::Splats;

use super::rows::Trained;
use crate::gaussians::{GaussianRows, RowsError};
use crate::state::{State, StateError};

/// What a strategy wants to be told of a step. What nobody wants is not computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    /// The gradient at the projected centres (Kerbl et al. 2023, section 5.2).
    pub gradient: bool,
    /// The same with the absolute value taken pixel by pixel (AbsGS, Ye et al. 2024, eq. 7): gradients of two edges of a
    /// Gaussian that is too large do not cancel.
    pub abs_gradient: bool,
    /// What each Gaussian covers of the picture, and how much of that is wrong; takes another render.
    pub covered: bool,
}

/// What there was to be told of a view; of a batch, each view is told by itself.
#[derive(Clone, Debug, Default)]
pub struct Observed {
    /// `[N, 2]`: `∂L/∂mean2d`, per px.
    pub gradient: Option<Tensor<2>>,
    /// `[N, 2]`: `Σ |∂L/∂mean2d|` over the pixels, per px.
    pub abs_gradient: Option<Tensor<2>>,
    /// `[N, 2]`: pixels covered, each by the Gaussian's share in its colour, and those of them whose error is above the picture's
    /// mean.
    pub covered: Option<Tensor<2>>,
    /// Width and height of the picture, px.
    pub size: (usize, usize),
}

/// Where a run is when a strategy acts.
#[derive(Clone, Copy, Debug)]
pub struct At<'a> {
    /// Counted from 1.
    pub step: usize,
    /// Of the whole run.
    pub steps: usize,
    /// See [`crate::optim::scene_extent`], scene units.
    pub extent: f64,
    /// The centres' learning rate in this step, scene units.
    pub means_rate: f64,
    /// `[2]`: on a GPU the device's verdict on this step and those before. Nothing may change where a step is entered in it (see
    /// [`splat_op::adam`]). Where [`Strategy::acts_at`] says so it has been read, and nothing is.
    pub verdict: Option<&'a Tensor<1, Int>>,
}

/// What a refinement did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RefineReport {
    /// Gaussians copied.
    pub cloned: usize,
    /// Large Gaussians split in two.
    pub split: usize,
    /// Gaussians removed.
    pub pruned: usize,
    /// The score above which Gaussians were copied or split; above the configured one at the cap. 0 where there is none.
    pub threshold: f64,
}

/// A policy on how many Gaussians there are, and where. The trainer calls it in the order of the functions below.
///
/// All that is random must come from the generator that is handed over, and all that is remembered must be saved: a run is to be
/// the same in every repetition, interrupted or not.
pub trait Strategy {
    /// Changes the first Gaussians before anything is trained.
    fn start(&mut self, _rows: &mut GaussianRows) {}

    /// What is wanted of `step`, counted from 1.
    fn listens_at(&self, _step: usize) -> Signals {
        Signals::default()
    }

    /// What is added to the loss of `step`, `[1]`, tracked. `splats` are activated.
    fn penalty(&self, _splats: &Splats, _step: usize) -> Option<Tensor<1>> {
        None
    }

    /// Is told what was wanted, before the optimiser's step.
    fn observe(&mut self, _seen: Observed) {}

    /// Whether [`Self::act`] reads the scene at `step`, or adds, removes or moves rows. The device is waited for then.
    fn acts_at(&self, step: usize) -> bool;

    /// Changes the scene after the optimiser's step; called at every step. A report says that rows were added, removed or
    /// moved, or are other Gaussians now.
    ///
    /// # Errors
    /// If the scene's rows do not fit together.
    fn act(&mut self, scene: &mut Trained, at: &At, rng: &mut dyn Rng) -> Result<Option<RefineReport>, RowsError>;

    /// Puts down what is remembered between steps.
    ///
    /// # Errors
    /// If something has no form in a state.
    fn save(&self, _to: &mut State) -> Result<(), StateError> {
        Ok(())
    }

    /// Takes up what [`Self::save`] has put down. `device` is the scene's, without autodiff.
    ///
    /// # Errors
    /// If something is missing, or is not what it should be.
    fn load(&mut self, _from: &mut State, _device: &Device) -> Result<(), StateError> {
        Ok(())
    }
}
