//! Effects during the exposure, learned for each photograph along with the scene: the camera moves while the shutter is
//! open, and rows are read one after the other.
//!
//! Each effect changes the projected ellipses by an operation of [`splat_op::optics`], in the order in which light passes shutter and
//! sensor. That holds for pinholes. For other cameras, motion blur averages renders from several poses along the motion
//! ([`motion::poses`]), at a multiple of the cost. Rolling shutters are not supported for them.
//!
//! Motion blur does not determine the sign of the motion and has no gradient at rest, so twists start slightly off zero.
//! Renders without these effects are sharp. These are compared with test views.

use burn::tensor::{Device, Gradients, Tensor};
use serde::{Deserialize, Serialize};
use splat_op::optics::{blurred, rolled};
use splat_op::{Camera, CameraModel, Intrinsics, Projected, SplatError};

use super::{Effect, EffectContext, Leaf, Learned, RenderInput, motion};
use crate::state::{State, StateError};

/// Selects the simulated effects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpticsConfig {
    /// Motion blur.
    pub motion: bool,
    /// Rolling shutter.
    pub rolling: bool,
}

impl OpticsConfig {
    /// Whether any effect is selected.
    pub fn any(self) -> bool {
        self.motion || self.rolling
    }
}

/// Reach of a twist in a run: rad, and scene extents.
const TWIST_REACH: [f32; 2] = [0.15, 0.1];

/// Initial rotation of twists, rad: half a pixel at a focal length of 250 px.
const TWIST_START: f64 = 2e-3;

/// Ratio of the last step size to the first.
const FALL: f64 = 0.01;

/// Number of renders that are averaged where ellipses cannot be changed.
const SUB_EXPOSURES: usize = 5;

/// The learned optics of all photographs of a run.
pub struct Optics {
    extent: f64,
    /// `[2, 3]` each: `ω`, rad, and `τ`, scene extents, over the exposure.
    exposures: Vec<Learned<2>>,
    /// `[2, 3]` each: `ω`, rad, and `τ`, scene extents, over the readout of the rows.
    readouts: Vec<Learned<2>>,
}

impl Optics {
    /// Parameters for photographs of these cameras, of a scene of `extent`.
    ///
    /// # Errors
    /// The camera model if rolling shutters are selected and a camera is not a pinhole.
    pub fn new(
        config: OpticsConfig,
        cameras: &[Intrinsics],
        extent: f64,
        device: &Device,
    ) -> Result<Self, CameraModel> {
        let lens = cameras.iter().map(|camera| camera.model).find(|model| *model != CameraModel::Pinhole);
        if let Some(model) = lens.filter(|_| config.rolling) {
            return Err(model);
        }
        let reach = Tensor::<2>::from_floats(TWIST_REACH.map(|reach| [reach; 3]), device);
        let learned = |on: bool, start: &dyn Fn(usize) -> Tensor<2>| -> Vec<Learned<2>> {
            let views = 0..if on { cameras.len() } else { 0 };
            views.map(|view| Learned::reaching(start(view), reach.clone())).collect()
        };
        // Directions by the golden angle, one after the other.
        let twist = |view: usize| {
            let (sin, cos) = (2.399_963 * view as f64).sin_cos();
            let [x, y] = [cos, sin].map(|share| (TWIST_START * share) as f32);
            Tensor::from_floats([[x, y, 0.0], [0.0; 3]], device)
        };
        Ok(Self {
            extent,
            exposures: learned(config.motion, &twist),
            readouts: learned(config.rolling, &|_| Tensor::zeros([2, 3], device)),
        })
    }

    /// The change of the ellipses in a render of `view`. `margin` is that of the Jacobian.
    fn edit(&mut self, view: usize, margin: f64) -> impl Fn(Projected) -> Result<Projected, SplatError> + use<> {
        let extent = self.extent;
        let exposure = self.exposures.get_mut(view).map(|exposure| twist(exposure, extent));
        let readout = self.readouts.get_mut(view).map(|readout| twist(readout, extent));
        move |projected| {
            let projected = exposure.iter().try_fold(projected, |of, twist| blurred(&of, twist, margin))?;
            readout.iter().try_fold(projected, |of, twist| rolled(&of, twist, margin))
        }
    }
}

/// `[6]`: a twist in rad and scene units, tracked.
fn twist(learned: &mut Learned<2>, extent: f64) -> Tensor<1> {
    let rows = learned.tracked();
    let moved = rows.clone().narrow(0, 1, 1) * extent;
    Tensor::cat(vec![rows.narrow(0, 0, 1), moved], 0).reshape([6])
}

impl Effect for Optics {
    fn name(&self) -> &'static str {
        "optics"
    }

    fn samples(&mut self, mut input: RenderInput, at: EffectContext) -> Vec<RenderInput> {
        if input.camera.intrinsics.model == CameraModel::Pinhole {
            let margin = input.options.jacobian_margin;
            input.edit_projected(self.edit(at.view, margin));
            return vec![input];
        }
        let Some(exposure) = self.exposures.get_mut(at.view) else { return vec![input] };
        let poses = motion::poses(&input.camera.cam_from_world, &twist(exposure, self.extent), SUB_EXPOSURES);
        let from = |cam_from_world| {
            let camera = Camera { cam_from_world, ..input.camera.clone() };
            RenderInput { camera, ..input.clone() }
        };
        poses.into_iter().map(from).collect()
    }

    fn leaves(&mut self, at: EffectContext) -> Vec<Leaf> {
        let of_view = [&mut self.exposures, &mut self.readouts];
        of_view.into_iter().filter_map(|all| all.get_mut(at.view)).map(Learned::leaf).collect()
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        for all in [&mut self.exposures, &mut self.readouts] {
            let views = all.len();
            if let Some(learned) = all.get_mut(at.view) {
                learned.step_within(gradients, FALL, views, at);
            }
        }
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        let parts = [("exposures", &self.exposures), ("readouts", &self.readouts)];
        parts.into_iter().try_for_each(|(name, all)| to.in_part(name, |part| Learned::save_all(all, part)))
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        let parts = [("exposures", &mut self.exposures), ("readouts", &mut self.readouts)];
        parts.into_iter().try_for_each(|(name, all)| from.load_part(name, |part| Learned::load_all(all, part)))
    }
}

#[cfg(test)]
mod tests;
