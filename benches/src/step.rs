//! A training step on a scene as it is.

use burn::tensor::{Int, Tensor};
use splat_model::density::rows::{Gradients, StepRates, Trained};
use splat_model::density::{Adaptive, AdaptiveConfig};
use splat_model::gaussians::Gaussians;
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::{Adam, LearningRates};
use splat_op::activate::non_finite;
use splat_op::{Camera, Extras, SplatError, is_gpu, render_view};

use crate::job::OPTIONS;

/// What [`splat_model::trainer::Trainer::step`] does, without refinement, so that the count stays; a trainer starts from points
/// and could not take a scene.
pub struct Step {
    scene: Trained,
    density: Adaptive,
    camera: Camera,
    background: Tensor<1>,
    truth: Truth,
    step: usize,
}

impl Step {
    /// `gaussians` are on an autodiff device, `camera` and `truth` on the one beneath it.
    pub fn new(gaussians: Gaussians, camera: Camera, truth: Truth) -> Self {
        let background = Tensor::zeros([3], &camera.cam_from_world.device());
        Self { scene: Trained::new(gaussians), density: density(), camera, background, truth, step: 0 }
    }

    /// The loss, `[1]`.
    ///
    /// # Errors
    /// If the op refuses the scene.
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
            self.density.observe(grad, (intrinsics.width, intrinsics.height));
        }
        let gradients = Gradients::take(&self.scene.gaussians, &mut grads);
        drop(grads);
        let loss = loss.inner();
        look(&loss, &gradients);
        self.scene.step(gradients, &Adam::default(), &rates(), self.step, None);
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

/// Whether the loss and all gradients are finite, as a trainer asks before it takes a step. On a GPU the answer stays there.
pub(crate) fn look(loss: &Tensor<1>, gradients: &Gradients) -> Vec<Tensor<1, Int>> {
    let Gradients { means, rotations, log_scales, logit_opacities, sh_dc, sh_rest } = gradients;
    let flags = [
        Some(non_finite(loss)),
        means.as_ref().map(non_finite),
        rotations.as_ref().map(non_finite),
        log_scales.as_ref().map(non_finite),
        logit_opacities.as_ref().map(non_finite),
        sh_dc.as_ref().map(non_finite),
        sh_rest.as_ref().map(non_finite),
    ];
    let flags: Vec<_> = flags.into_iter().flatten().collect();
    if !is_gpu(&loss.device()) {
        assert!(flags.iter().all(|flag| flag.clone().into_scalar::<i32>() == 0), "a loss or a gradient is not finite");
    }
    flags
}
