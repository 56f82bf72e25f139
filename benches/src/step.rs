//! A training step on a given scene.

use burn::tensor::Tensor;
use splat_model::density::rows::{Gradients, StepRates, Trained};
use splat_model::density::{Adaptive, AdaptiveConfig, Observed, Strategy};
use splat_model::gaussians::Gaussians;
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::{Adam, LearningRates, MomentBits};
use splat_model::trainer::Guard;
use splat_op::{Camera, Extras, SplatError, render_view};

use crate::job::OPTIONS;

/// Performs the step of [`splat_model::trainer::Trainer::step`] without refinement, so that the number of Gaussians stays constant.
/// A trainer starts from points and does not accept a scene.
pub struct Step {
    scene: Trained,
    density: Adaptive,
    camera: Camera,
    background: Tensor<1>,
    truth: Truth,
    guard: Guard,
    step: usize,
}

/// Reason why the guard does not stop a bench.
pub(crate) const SOUND: &str = "the scenes of the benches have finite losses and gradients";

impl Step {
    /// Creates a step. `gaussians` are on an autodiff device, `camera` and `truth` on its inner device.
    pub fn new(gaussians: Gaussians, camera: Camera, truth: Truth) -> Self {
        Self::with_moments(gaussians, camera, truth, MomentBits::ThirtyTwo)
    }

    /// Creates a step with moments of so many bits.
    pub fn with_moments(gaussians: Gaussians, camera: Camera, truth: Truth, bits: MomentBits) -> Self {
        let background = Tensor::zeros([3], &camera.cam_from_world.device());
        let guard = Guard::new(&camera.cam_from_world.device());
        let scene = Trained::with_bits(gaussians, bits);
        Self { scene, density: density(), camera, background, truth, guard, step: 0 }
    }

    /// Takes a step and returns the loss, `[1]`.
    pub fn run(&mut self) -> Result<Tensor<1>, SplatError> {
        self.step += 1;
        let splats = self.scene.gaussians.splats();
        let probe = Tensor::<2>::zeros([self.scene.gaussians.len(), 2], &splats.means.device()).require_grad();
        let extras = Extras {
            background: Some(self.background.clone()),
            mean2d_probe: Some(probe.clone()),
            ..Extras::default()
        };
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
}

pub(crate) fn density() -> Adaptive {
    Adaptive::new(AdaptiveConfig::default(), 1.0, 30_000)
}

pub(crate) fn rates() -> StepRates {
    let rates = LearningRates::default();
    StepRates { rates, means: rates.means }
}
