//! The effects of one run, as a training loop uses them: in the order in which light goes through them.

mod state;

use burn::tensor::{Bool, Device, Tensor};
use glam::DAffine3;
use rand::Rng;
use splat_op::{Camera, Intrinsics, Rendered, Splats};

use super::Effect;
use super::background::{Background, Behind};
use super::depth::Depths;
use super::exposure::Exposure;
use super::grid::Grids;
use super::learned::Moment;
use super::masks;
use super::optics::{Optics, OpticsGradients};
use super::pose::Poses;
use super::smoothing::Smoothing;
use crate::gaussians::Gaussians;

/// Those of one run. Without any it holds nothing and does nothing.
#[derive(Default)]
pub struct Applied {
    pub(crate) smoothing: Option<Smoothing>,
    pub(crate) poses: Option<Poses>,
    pub(crate) optics: Option<Optics>,
    pub(crate) behind: Option<Behind>,
    pub(crate) exposure: Option<Exposure>,
    pub(crate) grids: Option<Grids>,
    pub(crate) depths: Option<Depths>,
}

/// The gradients of the effects' parameters in one step.
#[derive(Default)]
pub struct EffectGradients {
    pose: Option<Tensor<2>>,
    optics: OpticsGradients,
    behind: Option<Tensor<2>>,
    exposure: Option<Tensor<2>>,
    grid: Option<Tensor<4>>,
}

impl Applied {
    /// The Gaussians of a step as they are rendered.
    pub fn splats(&mut self, gaussians: &Gaussians, step: usize) -> Splats {
        let splats = gaussians.splats();
        match &mut self.smoothing {
            Some(smoothing) => {
                smoothing.follow(gaussians, step);
                smoothing.apply(splats, gaussians.log_scales.val())
            }
            None => splats,
        }
    }

    /// Gaussians were added, removed or moved to other rows.
    pub fn forget_rows(&mut self) {
        if let Some(smoothing) = &mut self.smoothing {
            smoothing.forget();
        }
    }

    /// The camera of the photograph `view`, and what its pose adds to the loss, `[1]`.
    pub fn camera(&self, camera: Camera, view: usize) -> (Camera, Option<Tensor<1>>) {
        let Some(poses) = &self.poses else { return (camera, None) };
        let cam_from_world = poses.apply(camera.cam_from_world, view);
        let penalty = poses.penalty(cam_from_world.clone(), view);
        (Camera { cam_from_world, ..camera }, penalty)
    }

    /// The background of this step, where it is drawn at random.
    pub fn draw_background(&self, rng: &mut impl Rng) -> Option<[f32; 3]> {
        self.behind.as_ref()?.draw(rng)
    }

    /// `[3]`: what the operation blends over, if not the configuration's background or one that was drawn.
    pub fn background(&self, device: &Device) -> Option<Tensor<1>> {
        self.behind.as_ref()?.colour(device)
    }

    /// Whether the photograph's depth has to be rendered.
    pub fn needs_depth(&self, view: usize) -> bool {
        self.depths.as_ref().is_some_and(|depths| depths.knows(view))
    }

    /// The render `[H, W, 3]` as the photograph `view`, of this camera, would show it. `excluded`, `[1, H, W]`, says which
    /// pixels do not count: these are cleared, and must be so in the photograph.
    pub fn shown(
        &mut self,
        picture: &Rendered<3>,
        view: usize,
        camera: (&Intrinsics, &DAffine3),
        excluded: Option<&Tensor<3, Bool>>,
    ) -> Tensor<3> {
        let mut image = picture.colour.clone();
        if let Some(behind) = &mut self.behind {
            image = behind.behind(image, picture.alpha.clone(), view, camera);
        }
        self.developed(image, view, excluded)
    }

    /// What becomes of the light in the camera: the part of [`Self::shown`] after the scene.
    pub fn developed(&self, mut image: Tensor<3>, view: usize, excluded: Option<&Tensor<3, Bool>>) -> Tensor<3> {
        if let Some(exposure) = &self.exposure {
            image = exposure.apply(image, view);
        }
        if let Some(grids) = &self.grids {
            image = grids.apply(image, view);
        }
        match excluded {
            // Last, so that what is left out says nothing about the exposure either.
            Some(excluded) => masks::cleared(image, excluded),
            None => image,
        }
    }

    /// What the maps of colours add to the loss of a step on `view`, `[1]`.
    pub fn penalty(&self, view: usize) -> Option<Tensor<1>> {
        let exposure = self.exposure.as_ref().map(|exposure| exposure.penalty(view));
        let grid = self.grids.as_ref().map(|grids| grids.penalty(view));
        exposure.into_iter().chain(grid).reduce(|a, b| a + b)
    }

    /// What known depths add to it, `[1]`, at a step, counted from 1, of so many.
    pub fn depth_penalty(&mut self, picture: &Rendered<3>, view: usize, at: (usize, usize)) -> Option<Tensor<1>> {
        let depth = picture.depth.clone()?;
        self.depths.as_mut()?.penalty(depth, picture.alpha.clone(), view, at)
    }

    /// Takes the gradients of the effects' parameters for `view` out of those of a loss.
    pub fn take_gradients(&self, view: usize, gradients: &mut burn::tensor::Gradients) -> EffectGradients {
        EffectGradients {
            pose: self.poses.as_ref().and_then(|poses| poses.take_gradient(view, gradients)),
            optics: self.optics.as_ref().map(|optics| optics.take_gradients(view, gradients)).unwrap_or_default(),
            behind: self.behind.as_ref().and_then(|behind| behind.take_gradient(gradients)),
            exposure: self.exposure.as_ref().and_then(|exposure| exposure.take_gradient(view, gradients)),
            grid: self.grids.as_ref().and_then(|grids| grids.take_gradient(view, gradients)),
        }
    }

    /// The optimiser's step on those parameters.
    pub fn step(&mut self, gradients: EffectGradients, at: Moment) {
        if let (Some(poses), Some(gradient)) = (&mut self.poses, gradients.pose) {
            poses.step(gradient, at);
        }
        if let Some(optics) = &mut self.optics {
            optics.step(gradients.optics, at);
        }
        if let (Some(behind), Some(gradient)) = (&mut self.behind, gradients.behind) {
            behind.step(gradient, at);
        }
        if let (Some(exposure), Some(gradient)) = (&mut self.exposure, gradients.exposure) {
            exposure.step(gradient, at);
        }
        if let (Some(grids), Some(gradient)) = (&mut self.grids, gradients.grid) {
            grids.step(gradient, at);
        }
    }

    /// Exchanges what is held of one effect, so that a run can be timed without it.
    pub(crate) fn exchange(&mut self, effect: Effect, other: &mut Self) {
        use std::mem::swap;
        match effect {
            Effect::Antialias => swap(&mut self.smoothing, &mut other.smoothing),
            Effect::Alpha | Effect::Environment => swap(&mut self.behind, &mut other.behind),
            Effect::Exposure => swap(&mut self.exposure, &mut other.exposure),
            Effect::BilateralGrid => swap(&mut self.grids, &mut other.grids),
            Effect::PoseRefinement => swap(&mut self.poses, &mut other.poses),
            Effect::MotionBlur | Effect::RollingShutter | Effect::Defocus => swap(&mut self.optics, &mut other.optics),
            Effect::DepthSupervision => swap(&mut self.depths, &mut other.depths),
            // Held by the photographs.
            Effect::Masks => {}
        }
    }

    /// The background that was learnt, if one was.
    pub fn learnt_background(&self) -> Option<Background> {
        self.behind.as_ref()?.learnt()
    }
}
