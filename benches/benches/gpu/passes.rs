//! Each stage's passes and the whole training step, and what each moves at least.

use std::cell::RefCell;
use std::error::Error;
use std::rc::Rc;

use burn::backend::Dispatch;
use burn::tensor::{Device, Tensor};
use splat_benches::Load;
use splat_model::density::rows::{Gradients, StepRates, Trained};
use splat_model::density::{Adaptive, AdaptiveConfig};
use splat_model::loss::{DEFAULT_LAMBDA, Truth, photometric};
use splat_model::optim::{Adam, LearningRates};
use splat_op::blend::{BlendInputs, BlendSpec, PartsCell};
use splat_op::project::{ProjectInputs, ProjectSpec};
use splat_op::tile::HitCell;
use splat_op::{Camera, Colour, Extras, SplatBackend, SplatError, Splats, render_view, shade, with_gradient};

use crate::job::{COEFFICIENTS, Job, OPTIONS};
use crate::measure::{Kept, Pass, Timed};

/// f32 values that the parts of a scene and a picture hold.
struct Counts {
    geometry: usize,
    packed: usize,
    sh: usize,
    colours: usize,
    lists: usize,
    /// Colour and alpha.
    planes: usize,
    picture: usize,
}

impl Counts {
    fn new(job: &Job, load: &Load) -> Self {
        let (count, pixels) = (job.rows.len(), job.intrinsics.width * job.intrinsics.height);
        Self {
            geometry: (3 + 4 + 3 + 1) * count,
            packed: 7 * count,
            sh: 3 * COEFFICIENTS * count,
            colours: 3 * count,
            lists: load.hits,
            planes: 4 * pixels,
            picture: 3 * pixels,
        }
    }
}

/// All passes, in the order of a training step.
pub fn passes(job: &Job, load: &Load, device: &Device) -> Result<Vec<Pass>, Box<dyn Error>> {
    let Counts { geometry, packed, sh, colours, lists, planes, picture } = Counts::new(job, load);
    let camera = job.camera(device);
    let stages = Stages::new(job, device)?;
    // Parameters, gradients and two moments read; parameters and moments written.
    let adam = 7 * (geometry + sh);
    // The means are an input of `shade` too.
    let means = 3 * job.rows.len();
    let mut passes = Vec::new();
    let mut add = |name, floats: usize, prepare: Box<dyn FnMut() -> Result<Timed, Box<dyn Error>>>| {
        passes.push(Pass { name, bytes: size_of::<f32>() * floats, prepare });
    };

    let (splats, view) = (stages.splats.clone(), camera.clone());
    add("project", geometry + packed, forward(move || Ok(project_packed(&splats, &view))));
    let (splats, view, grad) = (stages.splats.clone(), camera.clone(), stages.packed.clone());
    add("project backward", 2 * geometry + packed, backward(grad, move || project_packed(&leaves(&splats), &view)));

    let (splats, view) = (stages.splats.clone(), camera.clone());
    add("shade", sh + means + colours, forward(move || shade(&harmonics(&splats), &splats.means, &view)));
    let (splats, view, grad) = (stages.splats.clone(), camera.clone(), stages.colours.clone());
    let run = move || {
        let splats = leaves(&splats);
        shade(&harmonics(&splats), &splats.means, &view).expect("as forwards")
    };
    add("shade backward", 2 * (sh + means) + colours, backward(grad, run));

    let (projected, spec) = (stages.packed.clone(), stages.spec);
    let tile = move || {
        let counts = <Dispatch as SplatBackend>::tile(projected.clone().into_dispatch(), spec, HitCell::default());
        Ok(Tensor::<2, burn::tensor::Int>::from_dispatch(counts))
    };
    add("tile", packed + lists, forward(tile));

    let shared = Rc::new(stages);
    let stages = shared.clone();
    let run = move || Ok(stages.blend(stages.packed.clone(), stages.colours.clone()));
    add("blend", packed + colours + lists + planes, forward(run));
    let (stages, grad) = (shared.clone(), shared.blend(shared.packed.clone(), shared.colours.clone()));
    let run = move || stages.blend(leaf(&stages.packed), leaf(&stages.colours));
    add("blend backward", 2 * (packed + colours) + lists + planes, backward(grad, run));

    let truth = Truth::new(job.photograph(device));
    let (image, seen) = (shared.image(job, &camera)?, truth.clone());
    let run = move || Ok(photometric(leaf(&image), &seen, DEFAULT_LAMBDA));
    // The photograph comes with its windowed mean and variance; the derivative is an output.
    add("loss with derivative", 5 * picture, forward(run));
    let (image, seen) = (shared.image(job, &camera)?, truth.clone());
    let run = move || {
        let loss = photometric(leaf(&image), &seen, DEFAULT_LAMBDA);
        Ok(Box::new(move || Ok(Box::new(loss.backward()) as Kept)) as Timed)
    };
    add("loss backward", 2 * picture, Box::new(run));

    let stages_of_a_step = (geometry + packed) + (2 * geometry + packed) + (sh + means + colours);
    let stages_of_a_step = stages_of_a_step + (2 * (sh + means) + colours) + (packed + lists);
    let stages_of_a_step = stages_of_a_step + 3 * (packed + colours) + 2 * (lists + planes) + 7 * picture;
    let step = Rc::new(RefCell::new(Step::new(job, truth, device)));
    let run = move || {
        let step = step.clone();
        Ok(Box::new(move || Ok(Box::new(step.borrow_mut().run()?) as Kept)) as Timed)
    };
    add("training step", stages_of_a_step + adam, Box::new(run));
    Ok(passes)
}

type Prepare = Box<dyn FnMut() -> Result<Timed, Box<dyn Error>>>;

/// Times the function.
fn forward<T: 'static>(run: impl Fn() -> Result<T, SplatError> + 'static) -> Prepare {
    let run = Rc::new(run);
    Box::new(move || {
        let run = run.clone();
        Ok(Box::new(move || Ok(Box::new(run()?) as Kept)))
    })
}

/// Runs the function, tracked, and times the pass back from its result, whose gradient is given.
fn backward<const D: usize>(grad: Tensor<D>, run: impl Fn() -> Tensor<D> + 'static) -> Prepare {
    Box::new(move || {
        let value = Tensor::<1>::zeros([1], &grad.device());
        let loss = with_gradient(run(), value, grad.clone());
        Ok(Box::new(move || Ok(Box::new(loss.backward()) as Kept)))
    })
}

/// The values as a leaf that Burn tracks.
fn leaf<const D: usize>(values: &Tensor<D>) -> Tensor<D> {
    Tensor::from_inner(values.clone()).require_grad()
}

fn leaves(splats: &Splats) -> Splats {
    Splats {
        means: leaf(&splats.means),
        rotations: leaf(&splats.rotations),
        scales: leaf(&splats.scales),
        opacities: leaf(&splats.opacities),
        colour: Colour::SphericalHarmonics(leaf(&harmonics(splats))),
    }
}

fn harmonics(splats: &Splats) -> Tensor<3> {
    let Colour::SphericalHarmonics(sh) = &splats.colour else { unreachable!("the scenes have harmonics") };
    sh.clone()
}

/// As [`splat_op::project`], but the packed columns themselves: `backward` needs their gradient, and going through the
/// named columns would time the slices.
fn project_packed(splats: &Splats, camera: &Camera) -> Tensor<2> {
    let probe = Tensor::<2>::zeros([0, 2], &splats.means.device());
    let inputs = ProjectInputs {
        means: splats.means.clone().into_dispatch(),
        rotations: splats.rotations.clone().into_dispatch(),
        scales: splats.scales.clone().into_dispatch(),
        opacities: splats.opacities.clone().into_dispatch(),
        cam_from_world: camera.cam_from_world.clone().into_dispatch(),
    };
    let spec = ProjectSpec { intrinsics: camera.intrinsics, options: OPTIONS };
    Tensor::from_dispatch(<Dispatch as SplatBackend>::project(inputs, probe.into_dispatch(), spec))
}

/// The stages' inputs on a device, without autodiff.
struct Stages {
    splats: Splats,
    packed: Tensor<2>,
    colours: Tensor<2>,
    counts: Tensor<2, burn::tensor::Int>,
    hits: HitCell,
    spec: BlendSpec,
}

impl Stages {
    fn new(job: &Job, device: &Device) -> Result<Self, SplatError> {
        let (splats, camera) = (job.gaussians(device).splats(), job.camera(device));
        let packed = project_packed(&splats, &camera);
        let colours = shade(&harmonics(&splats), &splats.means, &camera)?;
        let (hits, spec) = (HitCell::default(), BlendSpec { intrinsics: job.intrinsics, options: OPTIONS });
        let counts = <Dispatch as SplatBackend>::tile(packed.clone().into_dispatch(), spec, hits.clone());
        Ok(Self { splats, packed, colours, counts: Tensor::from_dispatch(counts), hits, spec })
    }

    /// As [`splat_op::blend`], for the reason of [`project_packed`].
    fn blend(&self, projected: Tensor<2>, features: Tensor<2>) -> Tensor<3> {
        let device = projected.device();
        let inputs = BlendInputs {
            background: Tensor::<1>::zeros([3], &device).into_dispatch(),
            projected: projected.into_dispatch(),
            features: features.into_dispatch(),
        };
        let probe = Tensor::<2>::zeros([0, 2], &device).into_dispatch();
        let counts = self.counts.clone().into_dispatch();
        let hits = self.hits.clone();
        let parts = PartsCell::default();
        let planes = <Dispatch as SplatBackend>::blend(inputs, probe, counts, self.spec, hits, None, parts.clone());
        Tensor::from_dispatch(<Dispatch as SplatBackend>::part(planes, 0, 4, parts))
    }

    /// `[H, W, 3]`, as `render_view` hands it to a loss.
    fn image(&self, job: &Job, camera: &Camera) -> Result<Tensor<3>, SplatError> {
        assert_eq!(job.rows.len(), self.packed.dims()[0]);
        Ok(render_view(&self.splats, camera, &Extras::default(), &OPTIONS)?.colour)
    }
}

/// A training step as [`splat_model::trainer::Trainer::step`] does it, without refinement, so that the count stays; a
/// trainer starts from points and could not take the scene as it is.
struct Step {
    scene: Trained,
    density: Adaptive,
    camera: Camera,
    background: Tensor<1>,
    truth: Truth,
    step: usize,
}

impl Step {
    fn new(job: &Job, truth: Truth, device: &Device) -> Self {
        Self {
            scene: Trained::new(job.gaussians(&device.clone().autodiff())),
            density: Adaptive::new(AdaptiveConfig::default(), 1.0, 30_000),
            camera: job.camera(device),
            background: Tensor::zeros([3], device),
            truth,
            step: 0,
        }
    }

    /// The loss, `[1]`.
    fn run(&mut self) -> Result<Tensor<1>, SplatError> {
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
        let rates = LearningRates::default();
        let means = rates.means;
        self.scene.step(gradients, &Adam::default(), &StepRates { rates, means }, self.step, None);
        Ok(loss.inner())
    }
}
