//! A training step on a given scene.

use burn::tensor::{DType, Device, Tensor};
use glam::DAffine3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use splat_model::density::rows::{Gradients, StepRates, Trained};
use splat_model::density::{Adaptive, AdaptiveConfig, Observed, Strategy, StrategyContext};
use splat_model::gaussians::{Gaussians, RowsError};
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::{Adam, LearningRates, MomentBits};
use splat_model::state::State;
use splat_model::trainer::Guard;
use splat_op::{Camera, Extras, SplatError, render_view};

use crate::SyntheticView;
use crate::job::OPTIONS;

/// Performs the step of [`splat_model::trainer::Trainer::step`] without refinement, so that the number of Gaussians stays constant.
pub struct Step {
    scene: Trained,
    density: Adaptive,
    camera: Camera,
    background: Tensor<1>,
    truth: Truth,
    guard: Guard,
    /// Values of the probe, as in the trainer.
    probe: Option<Tensor<2>>,
    step: usize,
}

/// Reason why the guard does not stop a bench.
pub(crate) const SOUND: &str = "the scenes of the benches have finite losses and gradients";

impl Step {
    /// Creates a step. `gaussians` are on an autodiff device, `camera` and `truth` on its inner device.
    pub fn new(gaussians: Gaussians, camera: Camera, truth: Truth) -> Self {
        Self::with_moments(gaussians, camera, truth, MomentBits::ThirtyTwo)
    }

    /// Creates a step of a synthetic scene on the CPU. The photograph is grey, so that the loss has a derivative everywhere.
    pub fn of(view: &SyntheticView, bits: MomentBits) -> Self {
        let device = Device::flex();
        let gaussians = Gaussians::from_rows(&view.rows(), &device.clone().autodiff()).expect("rows of one scene");
        let camera = Camera::new(view.camera(&device, DType::F32).intrinsics, &DAffine3::IDENTITY, &device);
        let truth = Truth::new(Tensor::<3>::ones([view.height, view.width, 3], &device) * 0.5);
        Self::with_moments(gaussians, camera, truth, bits)
    }

    /// Creates a step with moments of so many bits.
    pub fn with_moments(gaussians: Gaussians, camera: Camera, truth: Truth, bits: MomentBits) -> Self {
        let background = Tensor::zeros([3], &camera.cam_from_world.device());
        let guard = Guard::new(&camera.cam_from_world.device());
        let scene = Trained::with_bits(gaussians, bits);
        Self { scene, density: density(), camera, background, truth, guard, probe: None, step: 0 }
    }

    /// Takes a step and returns the loss, `[1]`.
    pub fn run(&mut self) -> Result<Tensor<1>, SplatError> {
        self.step += 1;
        let splats = self.scene.splats();
        let (rows, last) = (self.scene.gaussians.len(), self.probe.take());
        let values =
            last.unwrap_or_else(|| Tensor::<1>::empty([2 * rows], &self.background.device()).reshape([rows, 2]));
        let probe = Tensor::from_inner(values.clone()).require_grad();
        self.probe = Some(values);
        let extras = Extras::default().with_background(self.background.clone()).with_mean2d_probe(probe.clone());
        let picture = render_view(&splats, &self.camera, &extras, &OPTIONS)?;
        let loss = photometric(picture.colour, &self.truth, DEFAULT_LAMBDA);
        drop(splats);
        let mut grads = loss.backward();
        if let Some(grad) = probe.grad_remove(&mut grads) {
            let intrinsics = self.camera.intrinsics;
            let size = (intrinsics.width, intrinsics.height);
            self.density.observe(Observed { gradient: Some(grad), size, ..Observed::default() });
        }
        let gradients = Gradients::take(&self.scene.gaussians, &mut grads);
        drop(grads);
        let loss = loss.inner();
        let verdict = self.guard.look(self.step, 0, &loss, &gradients).expect(SOUND);
        self.scene.step(gradients, &Adam::default(), &rates(), self.step, verdict.as_ref());
        self.guard.read(false).expect(SOUND);
        Ok(loss)
    }

    /// Saves the scene and its moments, as a checkpoint does.
    pub fn save(&self) -> State {
        self.scene.save().expect("a scene without further groups")
    }

    /// Refines the scene once as `gradual` does where all Gaussians wait to become two: a fifth of them do, the most that a refinement takes.
    /// Returns the number of Gaussians.
    ///
    /// # Errors
    /// If the rows are inconsistent, which is a bug of the strategy.
    pub fn refine(&mut self) -> Result<usize, RowsError> {
        // All gradients exceed a negative threshold.
        let config = AdaptiveConfig {
            grad_threshold: -1.0,
            every: 1,
            from: 1,
            max_splats: 1 << 40,
            ..AdaptiveConfig::gradual()
        };
        let at = StrategyContext { step: 1, steps: 3, extent: 1.0, means_rate: 0.0, verdict: None };
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        Adaptive::new(config, at.extent, at.steps).act(&mut self.scene, &at, &mut rng)?;
        // Its statistics and its probe are of the rows before.
        (self.density, self.probe) = (density(), None);
        Ok(self.scene.gaussians.len())
    }
}

pub(crate) fn density() -> Adaptive {
    Adaptive::new(AdaptiveConfig::default(), 1.0, 30_000)
}

pub(crate) fn rates() -> StepRates {
    let rates = LearningRates::default();
    StepRates { rates, means: rates.means, done: 0.0, views: 1 }
}
