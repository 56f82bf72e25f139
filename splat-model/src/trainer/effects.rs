//! What a run has to do with effects: which it begins with, what they are told, and what they leave.

use burn::tensor::Device;
use glam::{DAffine3, Vec3};
use splat_op::Intrinsics;
use splat_op::shade::SH_DEGREE_MAX;

use super::{TrainConfig, TrainError, Trainer};
use crate::capture::{Photograph, PointCloud};
use crate::effects::background::{Backdrop, Background, Environment, LearnedBackground, RandomBackground};
use crate::effects::depth::{DepthSample, Depths};
use crate::effects::exposure::Exposure;
use crate::effects::grid::Grids;
use crate::effects::optics::Optics;
use crate::effects::pose::Poses;
use crate::effects::pose::anchors::Anchors;
use crate::effects::smoothing::Smoothing;
use crate::effects::{Effect, EffectStack};
use crate::gaussians::GaussianRows;

/// The effects of a run over `photos` of a scene of `extent`, as it begins, in the order in which light meets them.
pub(super) fn of(
    config: &TrainConfig,
    photos: &[Photograph],
    points: &PointCloud,
    extent: f64,
    device: &Device,
) -> Result<EffectStack, TrainError> {
    let (mut stack, views) = (EffectStack::default(), photos.len());
    if config.smoothing {
        stack.put(Smoothing::new(photos.iter().map(|photo| (&photo.intrinsics, &photo.cam_from_world))));
    }
    if let Some(poses) = config.poses {
        stack.put(Poses::new(poses, extent, views, device));
    }
    if config.optics.any() {
        let cameras: Vec<Intrinsics> = photos.iter().map(|photo| photo.intrinsics).collect();
        let distance = typical_depth(photos, points).unwrap_or(extent);
        stack.put(Optics::new(config.optics, &cameras, (extent, distance), device)?);
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
            return Err(TrainError::EnvironmentDegree(degree));
        }
        Backdrop::Environment { degree } => {
            let poses = photos.iter().map(|photo| photo.cam_from_world).collect();
            stack.put(Environment::new(degree, poses, device));
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

/// The median depth of the points in the photographs, scene units; none without points.
fn typical_depth(photos: &[Photograph], points: &PointCloud) -> Option<f64> {
    let every = points.positions.len().div_ceil(1000).max(1);
    let worlds = || points.positions.iter().step_by(every).map(|point| Vec3::from_array(*point).as_dvec3());
    let depths = photos.iter().flat_map(|photo| worlds().map(|world| photo.cam_from_world.transform_point3(world).z));
    let mut depths: Vec<f64> = depths.filter(|depth| *depth > 0.0).collect();
    depths.sort_unstable_by(f64::total_cmp);
    depths.get(depths.len() / 2).copied()
}

impl Trainer {
    /// The same run with an effect of the caller's, which light meets after those that are there; one of the same name gives it
    /// its place. To be asked for before the first step.
    pub fn with_effect(mut self, effect: impl Effect) -> Self {
        self.effects.put(effect);
        self
    }

    /// The effect of a type, such as one that was handed to [`Self::with_effect`], with what it has learnt.
    pub fn effect<T: Effect>(&self) -> Option<&T> {
        self.effects.get()
    }

    /// The same run, with what is known of the depth of things in each photograph, in the order of the photographs; nothing is
    /// learnt from it unless [`TrainConfig::depth`] says so.
    pub fn with_depths(mut self, samples: Vec<Vec<DepthSample>>) -> Self {
        if let Some(depth) = self.config.depth {
            self.effects.put(Depths::new(depth, samples, &self.device));
        }
        self
    }

    /// The same run, with the directions in which each photograph saw the sparse points, in the order of the photographs: where
    /// poses are refined, these are where it begins and what holds them.
    pub fn with_anchors(mut self, anchors: &[Anchors]) -> Self {
        let given: Vec<DAffine3> = (0..self.views.len()).map(|view| *self.views.camera_of(view).1).collect();
        if let Some(poses) = self.effects.get_mut::<Poses>() {
            poses.anchor(anchors, &given, &self.device);
        }
        self
    }

    /// The scene as others should render it: the parameters, or what effects make of them.
    pub fn rows(&self) -> GaussianRows {
        let mut rows = self.scene.gaussians.to_rows();
        self.effects.bake(&mut rows);
        rows
    }

    /// What is behind the scene, for whoever renders it.
    pub fn background(&self) -> Background {
        self.effects.background().unwrap_or(Background::Colour(self.config.background))
    }

    /// The photographs' names and their poses as refined, if they are.
    pub fn refined_poses(&self) -> Option<Vec<(String, DAffine3)>> {
        let poses = self.effects.get::<Poses>()?;
        let refined = |view: usize| {
            let (_, given) = self.views.camera_of(view);
            (self.views.name(view).to_owned(), poses.corrected(given, view))
        };
        Some((0..self.views.len()).map(refined).collect())
    }
}
