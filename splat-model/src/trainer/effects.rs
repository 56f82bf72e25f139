//! The effects of a run: their setup, their inputs and their results.

use burn::tensor::Device;
use glam::DAffine3;
use splat_op::Intrinsics;
use splat_op::sh::SH_DEGREE_MAX;

use super::{Result, TrainConfig, TrainError, Trainer};
use crate::capture::Photograph;
use crate::effects::background::{Backdrop, Background, Environment, LearnedBackground, RandomBackground};
use crate::effects::depth::{DepthSample, Depths};
use crate::effects::exposure::Exposure;
use crate::effects::grid::Grids;
use crate::effects::optics::Optics;
use crate::effects::pose::Poses;
use crate::effects::pose::anchors::Anchors;
use crate::effects::smoothing::Smoothing;
use crate::effects::{Effect, EffectStack};
use crate::gaussians::{GaussianRows, ROWS_AT_ONCE};

/// The initial effects of a run over `photos` of a scene of `extent`, in the order in which light passes them.
pub(super) fn of(config: &TrainConfig, photos: &[Photograph], extent: f64, device: &Device) -> Result<EffectStack> {
    let (mut stack, views) = (EffectStack::default(), photos.len());
    if config.smoothing {
        stack.put(Smoothing::new(photos.iter().map(|photo| (&photo.intrinsics, &photo.cam_from_world))));
    }
    if let Some(poses) = config.poses {
        stack.put(Poses::new(poses, extent, views, device));
    }
    if config.optics.any() {
        let cameras: Vec<Intrinsics> = photos.iter().map(|photo| photo.intrinsics).collect();
        stack.put(Optics::new(config.optics, &cameras, extent, device).map_err(TrainError::Optics)?);
    }
    if let Backdrop::Learned | Backdrop::Environment { .. } = config.backdrop
        && let Some(photo) = photos.iter().find(|photo| photo.has_alpha)
    {
        return Err(TrainError::LearntBackground(photo.name.clone()));
    }
    match config.backdrop {
        Backdrop::Fixed => {}
        Backdrop::Random => stack.put(RandomBackground),
        Backdrop::Learned => stack.put(LearnedBackground::new(config.background, device)),
        Backdrop::Environment { degree } if degree > SH_DEGREE_MAX => {
            let found = format!("the degree of `backdrop.environment` is {degree}, expected 0 to 4");
            return Err(TrainError::Option(found));
        }
        Backdrop::Environment { degree } => {
            let poses: Vec<_> = photos.iter().map(|photo| photo.cam_from_world).collect();
            stack.put(Environment::new(degree, &poses, device));
        }
    }
    if let Some(exposure) = config.exposure {
        stack.put(Exposure::new(exposure, views, device));
    }
    if let Some(grid) = config.grid {
        stack.put(Grids::new(grid, views, device));
    }
    Ok(stack)
}

impl Trainer {
    /// Adds a custom effect after the existing ones, or replaces the effect of the same name. Must be called before the first step.
    pub fn with_effect(mut self, effect: impl Effect) -> Self {
        self.effects.put(effect);
        self
    }

    /// The effect of type `T`, for example one that was passed to [`Self::with_effect`], with its learned parameters.
    pub fn effect<T: Effect>(&self) -> Option<&T> {
        self.effects.get()
    }

    /// Adds known depths of each photograph, in the order of the photographs. They are used only if [`TrainConfig::depth`] is set.
    pub fn with_depths(mut self, samples: Vec<Vec<DepthSample>>) -> Self {
        if let Some(depth) = self.config.depth {
            self.effects.put(Depths::new(depth, samples, &self.device));
        }
        self
    }

    /// Adds the observed directions of the sparse points in each photograph, in the order of the photographs. Pose
    /// refinement starts from them and is held by them.
    pub fn with_anchors(mut self, anchors: &[Anchors]) -> Self {
        let given: Vec<DAffine3> = (0..self.views.len()).map(|view| *self.views.pose(view)).collect();
        if let Some(poses) = self.effects.get_mut::<Poses>() {
            poses.anchor(anchors, &given, &self.device);
        }
        self
    }

    /// The scene for other renderers: the parameters after all effects that change them.
    pub fn rows(&self) -> GaussianRows {
        let mut rows = self.scene.gaussians.to_rows();
        self.effects.bake(&mut rows);
        rows
    }

    /// [`Self::rows`], some Gaussians at a time. All of them would take a quarter more memory than parameters and moments.
    pub fn parts_of_rows(&self) -> impl Iterator<Item = GaussianRows> {
        let count = self.scene.gaussians.len();
        (0..count).step_by(ROWS_AT_ONCE).map(move |first| {
            let mut rows = self.scene.gaussians.rows_in(first..count.min(first + ROWS_AT_ONCE));
            self.effects.bake(&mut rows);
            rows
        })
    }

    /// The background of the scene, for other renderers.
    pub fn background(&self) -> Background {
        self.effects.background().unwrap_or(Background::Colour(self.config.background))
    }

    /// Names and refined poses of the photographs. `None` if poses are not refined.
    pub fn refined_poses(&self) -> Option<Vec<(String, DAffine3)>> {
        let poses = self.effects.get::<Poses>()?;
        let refined = |view: usize| (self.views.name(view).to_owned(), poses.corrected(self.views.pose(view), view));
        Some((0..self.views.len()).map(refined).collect())
    }
}
