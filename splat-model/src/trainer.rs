//! Training of a scene from photographs. The caller drives it step by step, and so can observe, stop or extend it.

mod checked;
mod config;
mod differentiate;
mod effects;
mod error;
mod guard;
mod loss;
pub mod ranks;
mod resolution;
mod shared;
mod start;
mod state;
mod surface_loss;
mod views;

use std::any::Any;
use std::mem;
use std::rc::Rc;

use burn::tensor::{Device, Tensor};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use splat_op::{RenderOptions, in_tensor_code};

use crate::capture::{Photo, Photograph, PointCloud, PointsSeen};
use crate::density::rows::{StepRates, Trained};
use crate::density::{RefineReport, Strategy, StrategyContext};
use crate::effects::{Effect, EffectContext, EffectStack};
use crate::gaussians::{BASE_GROUPS, Gaussians, Group, GroupOptions};
use crate::loss::photometric;
use crate::optim::{Adam, scene_extent, sh_degree_at};

pub use self::config::TrainConfig;
use self::differentiate::Batch;
pub use self::error::{Result, TrainError};
pub use self::guard::{Fault, Guard};
pub use self::loss::{Loss, LossInputs};
use self::ranks::{Alone, Ranks};
pub use self::resolution::Resolution;
pub use self::surface_loss::SurfaceLoss;
use self::views::Views;

/// The result of a step.
#[derive(Clone, Debug)]
pub struct StepReport {
    /// Number of the step, counted from 1.
    pub step: usize,
    /// `[1]`: the loss, or its mean over a batch. Reading it waits for the device.
    pub loss: Tensor<1>,
    /// The photograph's name; the first photograph's in a batch.
    pub view: String,
    /// Number of Gaussians after the step.
    pub splats: usize,
    /// Report of density control, if it changed rows.
    pub refined: Option<RefineReport>,
}

/// A training run.
pub struct Trainer {
    config: TrainConfig,
    options: RenderOptions,
    device: Device,
    scene: Trained,
    views: Views,
    effects: EffectStack,
    density: Box<dyn Strategy>,
    /// See [`scene_extent`].
    extent: f64,
    loss: Box<dyn Loss>,
    guard: Guard,
    ranks: Rc<dyn Ranks>,
    /// Whether the ranks are known to begin from the same run.
    agreed: bool,
    rng: ChaCha8Rng,
    /// Remaining views of this epoch.
    queue: Vec<usize>,
    /// How many photographs show the points that the run started from.
    seen: PointsSeen,
    step: usize,
    /// `[3]`: the background of views without one of their own.
    background: Tensor<1>,
    /// `[N, 2]`: the values of the last step's probe, which nobody reads.
    probe: Option<Tensor<2>>,
}

impl Trainer {
    /// A run over `photos` on `device` that starts from `points`, or from random points if there are none: see [`matched_points`](crate::init::matched_points).
    ///
    /// # Errors
    /// If there are no photographs, and those of [`TrainConfig::check`].
    pub fn new(photos: Vec<Photo>, points: &PointCloud, config: TrainConfig, device: &Device) -> Result<Self> {
        Self::of(photos.into_iter().map(Photograph::from).collect(), points, config, device)
    }

    /// A run over photographs that need not all be in memory.
    ///
    /// # Errors
    /// Errors of [`Self::new`].
    pub fn of(photos: Vec<Photograph>, points: &PointCloud, config: TrainConfig, device: &Device) -> Result<Self> {
        if photos.is_empty() {
            return Err(TrainError::NoViews);
        }
        config.check()?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let (mut rows, seen) = start::first_rows(&photos, points, config.density.max_splats(), &mut rng);
        let centres: Vec<_> = photos.iter().map(|photo| photo.cam_from_world.inverse().translation).collect();
        let extent = scene_extent(&centres);
        let mut density = config.density.strategy(extent, config.steps);
        density.start(&mut rows);
        let tracked = device.clone().autodiff();
        let effects = effects::of(&config, &photos, extent, device)?;
        let views = Views::new(photos, config.background, config.cache_mib, device);
        let lambda = config.lambda;
        Ok(Self {
            options: config.render_options(extent),
            device: device.clone(),
            scene: Trained::with_bits(Gaussians::from_rows(&rows, &tracked)?, config.moment_bits),
            views,
            effects,
            density,
            extent,
            loss: Box::new(move |seen: &LossInputs| photometric(seen.image.clone(), seen.truth, lambda)),
            guard: Guard::new(device),
            ranks: Rc::new(Alone),
            agreed: false,
            rng,
            queue: Vec::new(),
            seen,
            step: 0,
            background: Tensor::from_floats(config.background, device),
            probe: None,
            config,
        })
    }

    /// Replaces the loss, L1 + D-SSIM, by a custom one. Must be called before the first step.
    pub fn with_loss(self, loss: impl Loss) -> Self {
        Self { loss: Box::new(loss), ..self }
    }

    /// The loss, if it is of type `T`, with its learned parameters.
    pub fn loss<T: Loss>(&self) -> Option<&T> {
        (&*self.loss as &dyn Any).downcast_ref()
    }

    /// Replaces density control by a custom strategy, which starts from the initial Gaussians of [`TrainConfig::density`].
    /// Must be called before the first step.
    ///
    /// # Errors
    /// If the initial rows of the strategy are inconsistent.
    pub fn with_strategy(mut self, mut strategy: impl Strategy + 'static) -> Result<Self> {
        let mut rows = self.scene.gaussians.to_rows();
        strategy.start(&mut rows);
        let gaussians = Gaussians::from_rows(&rows, &self.device.clone().autodiff())?;
        self.scene = Trained::with_bits(gaussians, self.config.moment_bits);
        self.density = Box::new(strategy);
        Ok(self)
    }

    /// Adds a group of parameters with rows of `width` zeros, which is trained, saved and carried along by density control like the
    /// others; losses read it by [`LossInputs::group`]. A group of that name and width that came with a scene ([`Self::from_scene`])
    /// keeps its values and gets the options. Must be called before the first step.
    ///
    /// # Errors
    /// If there is another group of that name, if files cannot hold the name, or if `width` is 0.
    pub fn with_group(mut self, name: &str, width: usize, options: GroupOptions) -> Result<Self> {
        let further = &mut self.scene.gaussians.groups[BASE_GROUPS.len()..];
        if let Some(group) = further.iter_mut().find(|group| group.name() == name && group.width() == width) {
            group.set_options(options);
            return Ok(self);
        }
        let zeros = Tensor::zeros([self.scene.gaussians.len(), width], &self.device);
        self.with_group_of(Group::new(name, zeros, options)?)
    }

    /// As [`Self::with_group`], with values of one's own on the scene's device.
    ///
    /// # Errors
    /// As [`Self::with_group`], and if the number of rows differs.
    pub fn with_group_of(self, group: Group) -> Result<Self> {
        Ok(Self { scene: self.scene.with_group(group)?, ..self })
    }

    /// Shares the views of each batch with other processes, which train the same run (see [`ranks`]). Before its first step, each
    /// rank checks that all begin from the same version, options, photographs and state. From then on every rank has to take the same
    /// steps. Steps wait for the device. Rank 0 always renders the first view of a batch; a rank without a view waits.
    pub fn with_ranks(self, ranks: Rc<dyn Ranks>) -> Self {
        let guard = if ranks.count() > 1 { Guard::default() } else { self.guard };
        Self { ranks, guard, ..self }
    }

    /// The current parameters of the scene. After a failed step, these are the parameters before that step.
    pub fn gaussians(&self) -> &Gaussians {
        &self.scene.gaussians
    }

    /// Render options of the run, which viewers of its scene should use too.
    pub fn render_options(&self) -> RenderOptions {
        self.options
    }

    /// Changes the length of the run and what depends on it, from the next step on: `steps`, `sh_every`, `learning_rates` and
    /// `resolution` of this configuration; its other fields are ignored. Schedules continue at the same step, which is another
    /// share of the run. For a run that must end at a certain time.
    ///
    /// # Errors
    /// If there would be no step left, or the schedule of sizes is out of range. Nothing changes then.
    pub fn reschedule(&mut self, to: &TrainConfig) -> Result<()> {
        if to.steps <= self.step {
            return Err(TrainError::NoSteps);
        }
        if !to.resolution.is_valid() {
            return Err(TrainError::Resolution(to.resolution));
        }
        let config = &mut self.config;
        (config.steps, config.sh_every) = (to.steps, to.sh_every);
        (config.learning_rates, config.resolution) = (to.learning_rates, to.resolution);
        self.density.set_steps(to.steps);
        Ok(())
    }

    /// The configuration of the run, with the current dials.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Extent of the scene (see [`scene_extent`]), scene units.
    pub fn extent(&self) -> f64 {
        self.extent
    }

    /// Number of completed steps.
    pub fn steps_done(&self) -> usize {
        self.step
    }

    /// Whether the run is over.
    pub fn is_done(&self) -> bool {
        self.step >= self.config.steps
    }

    /// Mean number of pixels of the photographs at full size.
    pub fn mean_pixels(&self) -> f64 {
        let pixels = |view| self.views.full_size(view).iter().product::<usize>() as f64;
        (0..self.views.len()).map(pixels).sum::<f64>() / self.views.len() as f64
    }

    /// Whether density control may change the number of Gaussians at `step` ([`Strategy::acts_at`]).
    pub fn refines_at(&self, step: usize) -> bool {
        self.density.acts_at(step)
    }

    /// Renders the views of a step, compares them with their photographs, and takes an optimiser step on every parameter.
    /// Density control follows.
    ///
    /// # Errors
    /// If the render operation rejects the scene, or if the loss or a gradient is not finite, or if no Gaussian is left. The scene then keeps its
    /// state before that step, and the run is over. On a GPU, which is not waited for, the error may come up to fifty steps
    /// later. The scene keeps its state before the failed step all the same.
    pub fn step(&mut self) -> Result<StepReport> {
        self.step_and_look(|_| {})
    }

    /// [`Self::step`], in which `look` is called once, with the scene as it was trained: before density control in steps of
    /// [`Strategy::acts_at`], and at the end of other steps. Rows that density control adds or moves have not been trained
    /// yet, so a scene scores lower right after a refinement.
    ///
    /// # Errors
    /// Errors of [`Self::step`]. `look` may not have been called then.
    pub fn step_and_look(&mut self, look: impl FnMut(&Self)) -> Result<StepReport> {
        if self.config.plain { in_tensor_code(|| self.take_step(look)) } else { self.take_step(look) }
    }

    fn take_step(&mut self, mut look: impl FnMut(&Self)) -> Result<StepReport> {
        let shared = self.ranks.count() > 1;
        let begins = shared && !mem::replace(&mut self.agreed, true);
        if begins {
            self.agree()?;
        }
        self.step += 1;
        let (step, steps) = (self.step, self.config.steps);
        self.views.reduce(self.config.resolution.divisor_at(step, steps));
        self.scene.grow_sh(sh_degree_at(step - 1, self.config.sh_every, self.config.sh_degree));

        let Batch { loss, gradients, passes, held } = self.differentiate_batch()?;
        let first = passes[0].0[0];
        let done = step as f64 / steps as f64;
        let rates = self.config.learning_rates.for_batch(self.config.batch).after(done);
        let rates = StepRates { rates, means: rates.means * self.extent, done, views: self.config.batch };
        let adam = Adam::default().for_batch(self.config.batch);
        self.scene.step(gradients, &adam, &rates, step, held.as_ref());
        for (views, mut left) in passes {
            let at = |view| EffectContext { view, step, steps, verdict: held.as_ref() };
            self.loss.step(&mut left, at(views[0]));
            views.into_iter().for_each(|view| self.effects.step(&mut left, at(view)));
        }
        // Refinement reads the scene and acts on it, so the verdict on earlier steps must be known.
        let refines = self.density.acts_at(step);
        let read = refines || self.is_done();
        self.guard.read(read).map_err(|fault| self.non_finite(fault))?;
        if refines {
            look(self);
        }
        let at = StrategyContext { step, steps, extent: self.extent, means_rate: rates.means, verdict: held.as_ref() };
        let refined = self.density.act(&mut self.scene, &at, &mut self.rng)?;
        if self.scene.gaussians.is_empty() {
            return Err(TrainError::NoSplats { step, seen: self.seen.clone() });
        }
        if read {
            self.scene.forget_mark();
        }
        if refined.is_some() {
            self.effects.forget_rows();
        }
        if begins || (shared && refines) {
            self.check_together()?;
        }
        if !refines {
            look(self);
        }
        let (view, splats) = (self.views.name(first).to_owned(), self.scene.gaussians.len());
        Ok(StepReport { step, loss, view, splats, refined })
    }

    /// The error of a step that was not taken, with the stage that goes wrong first.
    fn non_finite(&mut self, fault: Fault) -> TrainError {
        let Fault { step, view, what } = fault;
        let sound = "every stage of the render is finite, so it is the loss or a backward pass that goes wrong: usual causes are a root or a \
                     logarithm at zero, and a mean over an empty mask";
        let stage = self.first_wrong(view).unwrap_or(sound.into());
        TrainError::NonFinite { step, view: self.views.name(view).to_owned(), what, stage }
    }

    /// The next view: every photograph once per epoch, in random order.
    fn draw_view(&mut self) -> usize {
        if self.queue.is_empty() {
            self.queue = (0..self.views.len()).collect();
            self.queue.shuffle(&mut self.rng);
        }
        self.queue.pop().expect("filled above, and there is at least one view")
    }
}

#[cfg(test)]
mod custom_effect_tests;
#[cfg(test)]
mod effects_tests;
#[cfg(test)]
mod groups_tests;
#[cfg(test)]
mod loss_tests;
#[cfg(test)]
mod robust_tests;
#[cfg(test)]
mod strategies_tests;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
