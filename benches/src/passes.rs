//! The passes of each stage, the other passes of a training step, and the whole step.

use std::cell::RefCell;
use std::error::Error;
use std::rc::Rc;

use burn::tensor::{Device, Tensor};
use splat_model::density::rows::{Gradients, Trained};
use splat_model::density::{Observed, Strategy};
use splat_model::gaussians::Gaussians;
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::Adam;
use splat_model::trainer::Guard;
use splat_op::test_hooks;
use splat_op::{
    Camera, Colour, Extras, Intersections, Intrinsics, SplatError, Splats, intersect, project, rasterize, render_view,
    with_gradient,
};

use crate::job::{Job, OPTIONS};
use crate::limit::PassKind;
use crate::measure::{Pass, PassResult, Prepare, TimedPart, stateful};
use crate::step::{SOUND, Step, density, rates};

/// Returns all passes, in the order of a training step, then the step.
pub fn passes(job: &Job, device: &Device) -> Result<Vec<Pass>, Box<dyn Error>> {
    let stages = Rc::new(Stages::new(job, device)?);
    let truth = Truth::new(job.photograph(device));
    let gaussians = job.gaussians(device);
    let prepare: [(PassKind, Prepare); 15] = [
        (PassKind::Activate, forward(move || Ok(gaussians.splats()))),
        (PassKind::Project, stages.forward(|of| of.project(&of.splats))),
        (PassKind::Sh, stages.forward(|of| of.colours(&of.splats))),
        (PassKind::Intersect, stages.forward(|of| lists_of(&of.packed, of.camera.intrinsics))),
        (PassKind::Rasterize, stages.forward(Stages::rasterize)),
        (PassKind::Loss, loss(stages.image()?, truth.clone())),
        (PassKind::LossBackward, loss_backward(stages.image()?, truth.clone())),
        (
            PassKind::RasterizeBackward,
            stages.backward(stages.rasterize()?.permute([2, 0, 1]), |of| of.rasterize_tracked().expect("as forwards")),
        ),
        (
            PassKind::ShBackward,
            stages.backward(stages.colours.clone(), |of| of.colours(&leaves(&of.splats)).expect("as forwards")),
        ),
        (
            PassKind::ProjectBackward,
            stages.backward(stages.packed.clone(), |of| of.project(&leaves(&of.splats)).expect("as forwards")),
        ),
        (PassKind::ActivateBackward, activate_backward(job, device)),
        (PassKind::Observe, observe(job, device)),
        (PassKind::Guard, guard(job, device)),
        (PassKind::Adam, adam(job, device)),
        (PassKind::Step, step(job, truth, device)),
    ];
    Ok(prepare.into_iter().map(|(kind, prepare)| Pass { kind, prepare }).collect())
}

/// Returns the whole step alone.
pub fn whole_step(job: &Job, device: &Device) -> Pass {
    Pass { kind: PassKind::Step, prepare: step(job, Truth::new(job.photograph(device)), device) }
}

fn loss(image: Tensor<3>, truth: Truth) -> Prepare {
    forward(move || Ok(photometric(leaf(&image), &truth, DEFAULT_LAMBDA)))
}

fn loss_backward(image: Tensor<3>, truth: Truth) -> Prepare {
    Box::new(move || {
        let loss = photometric(leaf(&image), &truth, DEFAULT_LAMBDA);
        Ok(Box::new(move || Ok(Box::new(loss.backward()) as PassResult)) as TimedPart)
    })
}

/// Prepares the backward pass of the activation. The gradients of scales, opacities and harmonics are given. The other gradients
/// need no activation.
fn activate_backward(job: &Job, device: &Device) -> Prepare {
    let gaussians = job.gaussians(&device.clone().autodiff());
    let grads = job.gaussians(device).splats();
    Box::new(move || {
        let splats = gaussians.splats();
        let zero = Tensor::<1>::zeros([1], &grads.means.device());
        let loss = with_gradient(splats.scales.clone(), zero.clone(), grads.scales.clone())
            + with_gradient(splats.opacities.clone(), zero.clone(), grads.opacities.clone())
            + with_gradient(harmonics(&splats), zero, harmonics(&grads));
        Ok(Box::new(move || Ok(Box::new(loss.backward()) as PassResult)))
    })
}

fn observe(job: &Job, device: &Device) -> Prepare {
    let grad = Tensor::<2>::ones([job.rows.len(), 2], device) * 1e-4;
    let size = (job.intrinsics.width, job.intrinsics.height);
    let density = Rc::new(RefCell::new(density()));
    Box::new(move || {
        // Nothing else holds the gradient that a step passes on.
        let (density, grad) = (density.clone(), grad.clone() * 1.0);
        Ok(Box::new(move || {
            density.borrow_mut().observe(Observed { gradient: Some(grad), size, ..Observed::default() });
            Ok(Box::new(()) as PassResult)
        }))
    })
}

fn guard(job: &Job, device: &Device) -> Prepare {
    let gradients = gradients(&job.gaussians(device));
    let loss = Tensor::<1>::ones([1], device);
    forward(move || Ok(Guard::new(&loss.device()).look(1, 0, &loss, &gradients).expect(SOUND)))
}

fn adam(job: &Job, device: &Device) -> Prepare {
    let scene = Rc::new(RefCell::new(Trained::new(job.gaussians(&device.clone().autodiff()))));
    let plain = job.gaussians(device);
    let mut step = 0;
    Box::new(move || {
        step += 1;
        let (scene, gradients) = (scene.clone(), gradients(&plain));
        Ok(Box::new(move || {
            scene.borrow_mut().step(gradients, &Adam::default(), &rates(), step, None);
            Ok(Box::new(()) as PassResult)
        }))
    })
}

fn step(job: &Job, truth: Truth, device: &Device) -> Prepare {
    let gaussians = job.gaussians(&device.clone().autodiff());
    stateful(Step::new(gaussians, job.camera(device), truth), Step::run)
}

/// Prepares the timing of a function.
pub fn forward<T: 'static>(run: impl Fn() -> Result<T, SplatError> + 'static) -> Prepare {
    let run = Rc::new(run);
    Box::new(move || {
        let run = run.clone();
        Ok(Box::new(move || Ok(Box::new(run()?) as PassResult)))
    })
}

/// Runs the function, tracked, and prepares the timing of its backward pass from a given gradient of the result.
pub fn backward<const D: usize>(grad: Tensor<D>, run: impl Fn() -> Tensor<D> + 'static) -> Prepare {
    Box::new(move || {
        let value = Tensor::<1>::zeros([1], &grad.device());
        let loss = with_gradient(run(), value, grad.clone());
        Ok(Box::new(move || Ok(Box::new(loss.backward()) as PassResult)))
    })
}

/// Returns the values without their history, as a leaf that Burn tracks.
pub fn leaf<const D: usize>(values: &Tensor<D>) -> Tensor<D> {
    let values = if values.device().is_autodiff() { values.clone().inner() } else { values.clone() };
    Tensor::from_inner(values).require_grad()
}

/// Returns the parameters as leaves that Burn tracks.
pub fn leaves(splats: &Splats) -> Splats {
    Splats {
        means: leaf(&splats.means),
        rotations: leaf(&splats.rotations),
        scales: leaf(&splats.scales),
        opacities: leaf(&splats.opacities),
        colour: Colour::SphericalHarmonics(leaf(&harmonics(splats))),
    }
}

pub(crate) fn harmonics(splats: &Splats) -> Tensor<3> {
    let Colour::SphericalHarmonics(sh) = &splats.colour else { unreachable!("the scenes have harmonics") };
    sh.clone()
}

/// Runs [`splat_op::project`] and returns the packed columns: `backward` needs their gradient, and the
/// named columns would add the time of slices.
pub(crate) fn project_packed(
    splats: &Splats,
    camera: &Camera,
    probe: Option<Tensor<2>>,
) -> Result<Tensor<2>, SplatError> {
    let extras = Extras::default().with_mean2d_probe(probe);
    Ok(test_hooks::packed(&project(splats, camera, &extras, &OPTIONS)?).clone())
}

/// Lists packed ellipses.
pub(crate) fn lists_of(packed: &Tensor<2>, intrinsics: Intrinsics) -> Result<Intersections, SplatError> {
    intersect(&test_hooks::of_packed(packed.clone(), intrinsics), &OPTIONS)
}

/// Rasterizes packed ellipses without a background, `[H, W, 3]`.
pub(crate) fn picture_of(
    packed: &Tensor<2>,
    intrinsics: Intrinsics,
    features: &Tensor<2>,
    lists: &Intersections,
) -> Result<Tensor<3>, SplatError> {
    let projected = test_hooks::of_packed(packed.clone(), intrinsics);
    Ok(rasterize(&projected, features, lists, &Extras::default(), &OPTIONS)?.colour)
}

/// Inputs of the stages on a device, without autodiff.
struct Stages {
    splats: Splats,
    camera: Camera,
    packed: Tensor<2>,
    colours: Tensor<2>,
    lists: Intersections,
}

impl Stages {
    fn new(job: &Job, device: &Device) -> Result<Self, SplatError> {
        let (splats, camera) = (job.gaussians(device).splats(), job.camera(device));
        let packed = project_packed(&splats, &camera, None)?;
        let colours = splat_op::colours(&splats, &camera)?;
        let lists = lists_of(&packed, job.intrinsics)?;
        Ok(Self { splats, camera, packed, colours, lists })
    }

    /// Prepares the timing of a function of the stages.
    fn forward<T: 'static>(self: &Rc<Self>, run: impl Fn(&Self) -> Result<T, SplatError> + 'static) -> Prepare {
        let stages = self.clone();
        forward(move || run(&stages))
    }

    /// Prepares the timing of a function's [`backward`] pass.
    fn backward<const D: usize>(
        self: &Rc<Self>,
        grad: Tensor<D>,
        run: impl Fn(&Self) -> Tensor<D> + 'static,
    ) -> Prepare {
        let stages = self.clone();
        backward(grad, move || run(&stages))
    }

    fn project(&self, splats: &Splats) -> Result<Tensor<2>, SplatError> {
        project_packed(splats, &self.camera, None)
    }

    fn colours(&self, splats: &Splats) -> Result<Tensor<2>, SplatError> {
        splat_op::colours(splats, &self.camera)
    }

    fn rasterize(&self) -> Result<Tensor<3>, SplatError> {
        picture_of(&self.packed, self.camera.intrinsics, &self.colours, &self.lists)
    }

    /// Rasterizes planes `[3, H, W]`, as a step does, so that ellipses and colours have gradients.
    fn rasterize_tracked(&self) -> Result<Tensor<3>, SplatError> {
        let (packed, intrinsics) = (leaf(&self.packed), self.camera.intrinsics);
        Ok(picture_of(&packed, intrinsics, &leaf(&self.colours), &lists_of(&packed, intrinsics)?)?.permute([2, 0, 1]))
    }

    /// Renders `[H, W, 3]`, as `render_view` passes it to a loss.
    fn image(&self) -> Result<Tensor<3>, SplatError> {
        Ok(render_view(&self.splats, &self.camera, &Extras::default(), &OPTIONS)?.colour)
    }
}

/// Returns gradients that nothing else holds: a hundredth of the parameters.
fn gradients(gaussians: &Gaussians) -> Gradients {
    const SHARE: f64 = 0.01;
    let groups = gaussians.groups().iter();
    groups.fold(Gradients::default(), |gradients, group| gradients.with(group.name(), group.raw() * SHARE))
}
