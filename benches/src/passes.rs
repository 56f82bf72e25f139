//! The passes of each stage, the other passes of a training step, and the whole step.

use std::cell::RefCell;
use std::error::Error;
use std::rc::Rc;

use burn::backend::Dispatch;
use burn::tensor::{Device, Int, Tensor};
use splat_model::density::rows::{Gradients, Trained};
use splat_model::density::{Observed, Strategy};
use splat_model::gaussians::Gaussians;
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::Adam;
use splat_model::trainer::Guard;
use splat_op::backend::{
    Geometry, IntersectionCell, Layers, PartsCell, ProjectSpec, RasterizeSpec, SplatBackend, TraceCell,
};
use splat_op::test_hooks::{self, PairCounts};
use splat_op::{Camera, Colour, Extras, SplatError, Splats, render_view, with_gradient};

use crate::job::{Job, OPTIONS};
use crate::limit::PassKind;
use crate::measure::{Pass, PassResult, Prepare, TimedPart, stateful};
use crate::step::{SOUND, Step, density, rates};
use crate::values;

/// Returns all passes, in the order of a training step, then the step.
pub fn passes(job: &Job, device: &Device) -> Result<Vec<Pass>, Box<dyn Error>> {
    let stages = Rc::new(Stages::new(job, device)?);
    let truth = Truth::new(job.photograph(device));
    let gaussians = job.gaussians(device);
    let prepare: [(PassKind, Prepare); 15] = [
        (PassKind::Activate, forward(move || Ok(gaussians.splats()))),
        (PassKind::Project, stages.forward(|of| Ok(of.project(&of.splats)))),
        (PassKind::Sh, stages.forward(|of| of.colours(&of.splats))),
        (PassKind::Intersect, stages.forward(|of| Ok(intersection_lists(&of.packed, of.spec)))),
        (PassKind::Rasterize, stages.forward(|of| Ok(of.rasterize(of.packed.clone(), of.colours.clone())))),
        (PassKind::Loss, loss(stages.image()?, truth.clone())),
        (PassKind::LossBackward, loss_backward(stages.image()?, truth.clone())),
        (
            PassKind::RasterizeBackward,
            stages.backward(stages.rasterize(stages.packed.clone(), stages.colours.clone()), |of| {
                of.rasterize(leaf(&of.packed), leaf(&of.colours))
            }),
        ),
        (
            PassKind::ShBackward,
            stages.backward(stages.colours.clone(), |of| of.colours(&leaves(&of.splats)).expect("as forwards")),
        ),
        (PassKind::ProjectBackward, stages.backward(stages.packed.clone(), |of| of.project(&leaves(&of.splats)))),
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
/// named columns would add the time of slices. `probe` is `[N, 2]`, or `[0, 2]` for none.
pub(crate) fn project_packed(splats: &Splats, camera: &Camera, probe: Tensor<2>) -> Tensor<2> {
    let inputs = Geometry {
        means: splats.means.clone().into(),
        rotations: splats.rotations.clone().into(),
        scales: splats.scales.clone().into(),
        opacities: splats.opacities.clone().into(),
        cam_from_world: camera.cam_from_world.clone().into(),
        mean2d: probe.into(),
    };
    let spec = ProjectSpec { intrinsics: camera.intrinsics, options: OPTIONS };
    Tensor::from_dispatch(<Dispatch as SplatBackend>::project(inputs, spec))
}

fn no_probe(splats: &Splats) -> Tensor<2> {
    Tensor::zeros([0, 2], &splats.means.device())
}

/// Runs [`splat_op::rasterize`] without a background on packed columns, for the reason given at [`project_packed`].
pub(crate) fn rasterize_planes(
    [projected, features]: [Tensor<2>; 2],
    (counts, intersections): (&Tensor<2, Int>, &IntersectionCell),
    spec: RasterizeSpec,
) -> Tensor<3> {
    traced_planes([projected, features], (counts, intersections), spec, None)
}

/// [`rasterize_planes`], which also fills `trace` if there is one.
fn traced_planes(
    [projected, features]: [Tensor<2>; 2],
    (counts, intersections): (&Tensor<2, Int>, &IntersectionCell),
    spec: RasterizeSpec,
    trace: Option<TraceCell>,
) -> Tensor<3> {
    let device = projected.device();
    let inputs = Layers {
        background: Tensor::<1>::zeros([3], &device).into(),
        projected: projected.into(),
        features: features.into(),
        mean2d_abs: Tensor::<2>::zeros([0, 2], &device).into(),
    };
    let counts = counts.clone().into_dispatch();
    let parts = PartsCell::default();
    let planes =
        <Dispatch as SplatBackend>::rasterize(inputs, counts, spec, intersections.clone(), trace, parts.clone());
    Tensor::from_dispatch(<Dispatch as SplatBackend>::part(planes, 0, 4, parts))
}

/// Counts the pairs of a pixel and a Gaussian that a GPU evaluates; `None` for a CPU.
pub fn pair_counts(job: &Job, device: &Device) -> Result<Option<PairCounts>, SplatError> {
    let (stages, trace) = (Stages::new(job, device)?, TraceCell::default());
    let inputs = [stages.packed.clone(), stages.colours.clone()];
    test_hooks::count_pairs(true);
    let planes = traced_planes(inputs, (&stages.counts, &stages.intersections), stages.spec, Some(trace.clone()));
    // Waits until the stages have run.
    values(planes);
    test_hooks::count_pairs(false);
    Ok(test_hooks::pair_counts(device, &trace))
}

/// Returns the lists of packed ellipses, and the number of Gaussians of each tile.
pub(crate) fn intersection_lists(packed: &Tensor<2>, spec: RasterizeSpec) -> (Tensor<2, Int>, IntersectionCell) {
    let intersections = IntersectionCell::default();
    let counts = <Dispatch as SplatBackend>::intersect(packed.clone().into_dispatch(), spec, intersections.clone());
    (Tensor::from_dispatch(counts), intersections)
}

/// Inputs of the stages on a device, without autodiff.
struct Stages {
    splats: Splats,
    camera: Camera,
    packed: Tensor<2>,
    colours: Tensor<2>,
    counts: Tensor<2, Int>,
    intersections: IntersectionCell,
    spec: RasterizeSpec,
}

impl Stages {
    fn new(job: &Job, device: &Device) -> Result<Self, SplatError> {
        let (splats, camera) = (job.gaussians(device).splats(), job.camera(device));
        let packed = project_packed(&splats, &camera, no_probe(&splats));
        let colours = splat_op::colours(&splats, &camera)?;
        let spec = RasterizeSpec { intrinsics: job.intrinsics, options: OPTIONS };
        let (counts, intersections) = intersection_lists(&packed, spec);
        Ok(Self { splats, camera, packed, colours, counts, intersections, spec })
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

    fn project(&self, splats: &Splats) -> Tensor<2> {
        project_packed(splats, &self.camera, no_probe(splats))
    }

    fn colours(&self, splats: &Splats) -> Result<Tensor<2>, SplatError> {
        splat_op::colours(splats, &self.camera)
    }

    fn rasterize(&self, projected: Tensor<2>, features: Tensor<2>) -> Tensor<3> {
        rasterize_planes([projected, features], (&self.counts, &self.intersections), self.spec)
    }

    /// Renders `[H, W, 3]`, as `render_view` passes it to a loss.
    fn image(&self) -> Result<Tensor<3>, SplatError> {
        Ok(render_view(&self.splats, &self.camera, &Extras::default(), &OPTIONS)?.colour)
    }
}

/// Returns gradients that nothing else holds: a hundredth of the parameters.
fn gradients(gaussians: &Gaussians) -> Gradients {
    const SHARE: f64 = 0.01;
    Gradients {
        means: Some(gaussians.means.val() * SHARE),
        rotations: Some(gaussians.rotations.val() * SHARE),
        log_scales: Some(gaussians.log_scales.val() * SHARE),
        logit_opacities: Some(gaussians.logit_opacities.val() * SHARE),
        sh: Some(gaussians.sh.val() * SHARE),
        sh_more: Vec::new(),
    }
}
