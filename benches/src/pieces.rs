//! A training step split into its passes. Each pass is timed in place, among the others and in the memory that they leave.

use std::time::Instant;

use burn::tensor::Tensor;
use splat_model::density::rows::{Gradients, Trained};
use splat_model::density::{Adaptive, Observed, Strategy};
use splat_model::gaussians::Gaussians;
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::Adam;
use splat_model::trainer::Guard;
use splat_op::{Camera, SplatError, evaluate_sh, with_gradient};

use crate::limit::PassKind;
use crate::passes::{harmonics, leaf, leaves, lists_of, picture_of, project_packed};
use crate::step::{SOUND, density, rates};

/// Performs the step of [`crate::step::Step`] with one graph per pass, so that the backward pass can also be timed pass by pass.
pub struct Pieces {
    scene: Trained,
    density: Adaptive,
    camera: Camera,
    truth: Truth,
    guard: Guard,
    step: usize,
}

/// Result of a step in pieces.
pub struct TimedStep {
    /// Loss, `[1]`.
    pub loss: Tensor<1>,
    /// Time of each pass, in the order of [`PassKind::PARTS`].
    pub seconds: [f64; PassKind::PARTS.len()],
}

/// A stopwatch for passes.
struct StopWatch {
    last: Instant,
    seconds: [f64; PassKind::PARTS.len()],
}

impl StopWatch {
    /// Adds the time since the last call to a pass.
    fn lap(&mut self, kind: PassKind) {
        let now = Instant::now();
        let place = PassKind::PARTS.iter().position(|part| *part == kind).expect("a part of a step");
        self.seconds[place] += (now - self.last).as_secs_f64();
        self.last = now;
    }

    /// Drops the time since the last call, which Burn spends between passes.
    fn skip(&mut self) {
        self.last = Instant::now();
    }
}

impl Pieces {
    /// Creates the step as [`crate::step::Step::new`] does. The device must be a CPU, where a call returns when its work is
    /// done.
    pub fn new(gaussians: Gaussians, camera: Camera, truth: Truth) -> Self {
        let guard = Guard::new(&camera.cam_from_world.device());
        Self { scene: Trained::new(gaussians), density: density(), camera, truth, guard, step: 0 }
    }

    /// Takes a step.
    pub fn run(&mut self) -> Result<TimedStep, SplatError> {
        self.step += 1;
        let mut watch = StopWatch { last: Instant::now(), seconds: [0.0; _] };
        let splats = self.scene.gaussians.splats();
        watch.lap(PassKind::Activate);

        let cut = leaves(&splats);
        let device = cut.means.device();
        let probe = Tensor::<2>::zeros([self.scene.gaussians.len(), 2], &device).require_grad();
        watch.skip();
        let packed = project_packed(&cut, &self.camera, Some(probe.clone()))?;
        watch.lap(PassKind::Project);
        // A separate leaf of the centres, so that the gradients of the two stages stay separate.
        let seen = leaf(&splats.means);
        let colours = evaluate_sh(&harmonics(&cut), &seen, &self.camera)?;
        watch.lap(PassKind::Sh);
        let lists = lists_of(&packed, self.camera.intrinsics)?;
        watch.lap(PassKind::Intersect);
        let [ellipses, features] = [leaf(&packed), leaf(&colours)];
        let rendered = picture_of(&ellipses, self.camera.intrinsics, &features, &lists)?;
        watch.lap(PassKind::Rasterize);
        let [height, width, _] = rendered.dims();
        let image = leaf(&rendered);
        watch.skip();
        let loss = photometric(image.clone(), &self.truth, DEFAULT_LAMBDA);
        watch.lap(PassKind::Loss);

        let grad = image.grad_remove(&mut loss.backward()).expect("the loss depends on the picture");
        watch.lap(PassKind::LossBackward);
        let device = grad.device();
        let zero = || Tensor::<1>::zeros([1], &device);
        watch.skip();
        let mut grads = with_gradient(rendered.permute([2, 0, 1]), zero(), grad.permute([2, 0, 1])).backward();
        let ellipses = ellipses.grad_remove(&mut grads).expect("the picture depends on the ellipses");
        let features = features.grad_remove(&mut grads).expect("the picture depends on the colours");
        drop((grads, lists));
        watch.lap(PassKind::RasterizeBackward);
        let mut grads = with_gradient(colours, zero(), features).backward();
        let sh = harmonics(&cut).grad_remove(&mut grads).expect("the colours depend on the harmonics");
        let through_direction = seen.grad_remove(&mut grads).expect("the colours depend on the direction");
        drop(grads);
        watch.lap(PassKind::ShBackward);
        let mut grads = with_gradient(packed, zero(), ellipses).backward();
        let shown = "the ellipses depend on all of them";
        let means = cut.means.grad_remove(&mut grads).expect(shown);
        let rotations = cut.rotations.grad_remove(&mut grads).expect(shown);
        let scales = cut.scales.grad_remove(&mut grads).expect(shown);
        let opacities = cut.opacities.grad_remove(&mut grads).expect(shown);
        let mean2d = probe.grad_remove(&mut grads).expect(shown);
        drop((grads, cut));
        watch.lap(PassKind::ProjectBackward);
        let means = means + through_direction;
        watch.skip();
        let activated = with_gradient(splats.scales.clone(), zero(), scales)
            + with_gradient(splats.opacities.clone(), zero(), opacities)
            + with_gradient(harmonics(&splats), zero(), sh);
        drop(splats);
        let mut grads = activated.backward();
        let gradients = Gradients::take(&self.scene.gaussians, &mut grads);
        let gradients = gradients.with("means", means).with("rotations", rotations);
        drop(grads);
        watch.lap(PassKind::ActivateBackward);

        self.density.observe(Observed { gradient: Some(mean2d), size: (width, height), ..Observed::default() });
        watch.lap(PassKind::Observe);
        let loss = loss.inner();
        self.guard.look(self.step, 0, &loss, &gradients).expect(SOUND);
        watch.lap(PassKind::Guard);
        self.scene.step(gradients, &Adam::default(), &rates(), self.step, None);
        watch.lap(PassKind::Adam);
        Ok(TimedStep { loss, seconds: watch.seconds })
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::job::{Job, JobSize};
    use crate::step::Step;

    #[test]
    fn pieces_are_the_step() {
        let device = Device::flex();
        let job = Job::new(JobSize::Tiny).expect("a synthetic scene");
        let gaussians = || job.gaussians(&device.clone().autodiff());
        let truth = Truth::new(job.photograph(&device));
        let mut whole = Step::new(gaussians(), job.camera(&device), truth.clone());
        let mut pieces = Pieces::new(gaussians(), job.camera(&device), truth);
        let mut losses = Vec::new();
        for _ in 0..5 {
            let expected = whole.run().expect("shapes fit").into_scalar::<f32>();
            let TimedStep { loss, seconds } = pieces.run().expect("shapes fit");
            assert_eq!(loss.into_scalar::<f32>(), expected);
            assert!(seconds.iter().all(|&part| part > 0.0), "{seconds:?}");
            losses.push(expected);
        }
        assert!(losses.windows(2).all(|pair| pair[1] < pair[0]), "{losses:?}");
    }
}
