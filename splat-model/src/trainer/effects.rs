//! What a run has to do with effects: which it begins with, what they are told, and what they leave.

use burn::tensor::Device;
use glam::{DAffine3, Vec3};
use splat_op::Intrinsics;
use splat_op::shade::SH_DEGREE_MAX;

use super::{TrainConfig, TrainError, Trainer};
use crate::capture::{Photograph, PointCloud};
use crate::effects::Applied;
use crate::effects::background::{Backdrop, Background, Behind};
use crate::effects::depth::{DepthSample, Depths};
use crate::effects::exposure::Exposure;
use crate::effects::grid::Grids;
use crate::effects::optics::Optics;
use crate::effects::pose::Poses;
use crate::effects::pose::anchors::Anchors;
use crate::effects::smoothing::Smoothing;
use crate::gaussians::GaussianRows;

/// The effects of a run over `photos` of a scene of `extent`, as it begins.
pub(super) fn of(
    config: &TrainConfig,
    photos: &[Photograph],
    points: &PointCloud,
    extent: f64,
    device: &Device,
) -> Result<Applied, TrainError> {
    if let Backdrop::Environment { degree } = config.backdrop
        && degree > SH_DEGREE_MAX
    {
        return Err(TrainError::EnvironmentDegree(degree));
    }
    let behind = Behind::new(config.backdrop, config.background, device);
    if behind.as_ref().is_some_and(Behind::is_learnt)
        && let Some(photo) = photos.iter().find(|photo| photo.has_alpha)
    {
        return Err(TrainError::LearntBackground(photo.name.clone()));
    }
    let optics = match config.optics.any() {
        true => {
            let cameras: Vec<Intrinsics> = photos.iter().map(|photo| photo.intrinsics).collect();
            let distance = typical_depth(photos, points).unwrap_or(extent);
            Some(Optics::new(config.optics, &cameras, (extent, distance), device)?)
        }
        false => None,
    };
    Ok(Applied {
        optics,
        smoothing: config
            .smoothing
            .then(|| Smoothing::new(photos.iter().map(|photo| (&photo.intrinsics, &photo.cam_from_world)))),
        poses: config.poses.map(|poses| Poses::new(poses, extent, photos.len(), device)),
        behind,
        exposure: config.exposure.map(|exposure| Exposure::new(exposure, photos.len(), device)),
        grids: config.grid.map(|grid| Grids::new(grid, photos.len(), device)),
        depths: None,
    })
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
    /// The same run, with what is known of the depth of things in each photograph, in the order of the photographs; nothing is
    /// learnt from it unless [`TrainConfig::depth`] says so.
    pub fn with_depths(mut self, samples: Vec<Vec<DepthSample>>) -> Self {
        self.effects.depths = self.config.depth.map(|depth| Depths::new(depth, samples, &self.device));
        self
    }

    /// The same run, with the directions in which each photograph saw the sparse points, in the order of the photographs: where
    /// poses are refined, these are where it begins and what holds them.
    pub fn with_anchors(mut self, anchors: &[Anchors]) -> Self {
        let given: Vec<DAffine3> = (0..self.views.len()).map(|view| *self.views.camera_of(view).1).collect();
        if let Some(poses) = &mut self.effects.poses {
            poses.anchor(anchors, &given, &self.device);
        }
        self
    }

    /// The scene as others should render it: the parameters, or what smoothing makes of them.
    pub fn rows(&self) -> GaussianRows {
        let mut rows = self.scene.gaussians.to_rows();
        if let Some(smoothing) = &self.effects.smoothing {
            smoothing.bake(&mut rows);
        }
        rows
    }

    /// What is behind the scene, for whoever renders it.
    pub fn background(&self) -> Background {
        self.effects.learnt_background().unwrap_or(Background::Colour(self.config.background))
    }

    /// The photographs' names and their poses as refined, if they are.
    pub fn refined_poses(&self) -> Option<Vec<(String, DAffine3)>> {
        let poses = self.effects.poses.as_ref()?;
        let refined = |view: usize| {
            let (_, given) = self.views.camera_of(view);
            (self.views.name(view).to_owned(), poses.corrected(given, view))
        };
        Some((0..self.views.len()).map(refined).collect())
    }
}
