//! Effects during the exposure, learned for each photograph along with the scene: the camera moves while the shutter is
//! open ([`motion`]), rows are read one after the other ([`motion::rolled`]), and the lens has a focus distance
//! ([`defocus`]).
//!
//! Each effect changes the projected ellipses, between [`project`](splat_op::project()) and [`intersect`](splat_op::intersect()), in
//! the order in which light passes lens, shutter and sensor. That holds for pinholes. For other cameras, motion blur
//! averages renders from several poses along the motion, at a multiple of the cost. Rolling shutters and defocus are not
//! supported for them.
//!
//! Defocus averages renders for pinholes too: six positions in the aperture, each of which moves centres by their circle of
//! confusion and widens ellipses by the blur of its part of the aperture. Widening alone spreads the light of each Gaussian
//! instead of the surface's: a disc of many pixels around splats of one pixel leaves a wall half transparent. On the demo
//! `--defocus` widening alone gained nothing.
//!
//! Motion blur does not determine the sign of the motion and has no gradient at rest, so twists start slightly off zero.
//! Renders without these effects are sharp. These are compared with test views.

use burn::tensor::{Device, Gradients, Tensor};
use serde::{Deserialize, Serialize};
use splat_op::{Camera, CameraModel, Ellipses, Intrinsics, RenderOptions};

use super::learned::{EffectContext, Learned};
use super::screen::ScreenError;
use super::{Effect, RenderInput, defocus, motion};
use crate::state::{State, StateError};

/// Selects the simulated effects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpticsConfig {
    /// Motion blur.
    pub motion: bool,
    /// Rolling shutter.
    pub rolling: bool,
    /// Defocus.
    pub defocus: bool,
}

impl OpticsConfig {
    /// Whether any effect is selected.
    pub fn any(self) -> bool {
        self.motion || self.rolling || self.defocus
    }
}

/// Reach of a twist in a run: rad, and scene extents.
const TWIST_REACH: [f32; 2] = [0.15, 0.1];

/// Initial rotation of twists, rad: half a pixel at a focal length of 250 px.
const TWIST_START: f64 = 2e-3;

/// Reach in a run of the aperture's logarithm and of the inverse focus distance, per extent.
const LENS_REACH: [f32; 2] = [2.0, 0.6];

/// Initial radius of the aperture, scene extents.
const APERTURE_START: f64 = 0.02;

/// Ratio of the last step size to the first.
const FALL: f64 = 0.01;

/// Number of renders that are averaged where ellipses cannot be changed.
const SUB_EXPOSURES: usize = 5;

/// Number of positions in the aperture: one in the middle, the others around it, in unit radii. Each represents a sixth of
/// the disc. The second moments of the positions and of the sixths add up to the disc's.
const PLACES: usize = 6;

/// Position `i`, in units of the aperture's radius.
fn place(i: usize) -> [f32; 2] {
    if i == 0 {
        return [0.0; 2];
    }
    // A disc of radius 1 has variance 1/4 along each axis, a disc of a sixth of its area 1/24. The five outer positions
    // supply the rest: 5/6 · ρ²/2 = 1/4 − 1/24.
    let (radius, angle) = (0.5_f64.sqrt(), std::f64::consts::TAU * i as f64 / (PLACES - 1) as f64);
    [angle.cos(), angle.sin()].map(|share| (radius * share) as f32)
}

/// The learned optics of all photographs of a run.
pub struct Optics {
    extent: f64,
    /// `[2, 3]` each: `ω`, rad, and `τ`, scene extents, over the exposure.
    exposures: Vec<Learned<2>>,
    /// `[2, 3]` each: `ω`, rad, and `τ`, scene extents, over the readout of the rows.
    readouts: Vec<Learned<2>>,
    /// `[1, 2]` each: the logarithm of the aperture's radius divided by the scene extent, and the scene extent divided by
    /// the focus distance.
    lenses: Vec<Learned<2>>,
}

impl Optics {
    /// Parameters for photographs of these cameras, of a scene of `extent` whose middle is at a distance of `distance`.
    ///
    /// # Errors
    /// [`ScreenError::Lens`] if rolling shutters or defocus are selected and a camera is not a pinhole.
    pub fn new(
        config: OpticsConfig,
        cameras: &[Intrinsics],
        (extent, distance): (f64, f64),
        device: &Device,
    ) -> Result<Self, ScreenError> {
        let lens = cameras.iter().map(|camera| camera.model).find(|model| *model != CameraModel::Pinhole);
        if let Some(model) = lens.filter(|_| config.rolling || config.defocus) {
            return Err(ScreenError::Lens(model));
        }
        let learned = |on: bool, start: &dyn Fn(usize) -> Tensor<2>, reach: Tensor<2>| -> Vec<Learned<2>> {
            let views = 0..if on { cameras.len() } else { 0 };
            views.map(|view| Learned::reaching(start(view), reach.clone())).collect()
        };
        let twists = Tensor::<2>::from_floats(TWIST_REACH.map(|reach| [reach; 3]), device);
        // Directions by the golden angle, one after the other.
        let twist = |view: usize| {
            let (sin, cos) = (2.399_963 * view as f64).sin_cos();
            let [x, y] = [cos, sin].map(|share| (TWIST_START * share) as f32);
            Tensor::from_floats([[x, y, 0.0], [0.0; 3]], device)
        };
        let focus = |_| Tensor::from_floats([[APERTURE_START.ln() as f32, (extent / distance) as f32]], device);
        Ok(Self {
            extent,
            exposures: learned(config.motion, &twist, twists.clone()),
            readouts: learned(config.rolling, &|_| Tensor::zeros([2, 3], device), twists),
            lenses: learned(config.defocus, &focus, Tensor::from_floats([LENS_REACH], device)),
        })
    }

    /// The change of the ellipses in a render of `view` through a position of the aperture. It fails for a camera with a lens.
    fn edit(
        &mut self,
        view: usize,
        place: [f32; 2],
        (camera, options): (Intrinsics, RenderOptions),
    ) -> impl Fn(Ellipses) -> Result<Ellipses, ScreenError> + use<> {
        let extent = self.extent;
        // Logarithm of the aperture's radius, scene units, and the inverse of the distance in focus, `[1]` each.
        let lens = self.lenses.get_mut(view).map(|lens| {
            let lens = lens.tracked();
            let log_aperture = lens.clone().narrow(1, 0, 1).reshape([1]) + extent.ln();
            (log_aperture, lens.narrow(1, 1, 1).reshape([1]) / extent)
        });
        let exposure = self.exposures.get_mut(view).map(|exposure| twist(exposure, extent));
        let readout = self.readouts.get_mut(view).map(|readout| twist(readout, extent));
        move |mut ellipses| {
            if let Some((log_aperture, inverse_focus)) = &lens {
                let radii = defocus::confusion(&ellipses, &camera, log_aperture, inverse_focus)?;
                let place = Tensor::<2>::from_floats([place], &radii.device());
                ellipses.mean2d = ellipses.mean2d + radii.clone() * place;
                ellipses = defocus::blurred(ellipses, radii / (PLACES as f64).sqrt());
            }
            if let Some(exposure) = &exposure {
                let velocity = motion::velocity(&ellipses, &camera, exposure, &options)?;
                ellipses = motion::blurred(ellipses, velocity);
            }
            if let Some(readout) = &readout {
                let velocity = motion::velocity(&ellipses, &camera, readout, &options)?;
                ellipses = motion::rolled(ellipses, velocity, camera.height);
            }
            Ok(ellipses)
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

    fn samples(&mut self, input: RenderInput, at: EffectContext) -> Vec<RenderInput> {
        let (camera, options) = (input.camera.intrinsics, input.options);
        if camera.model == CameraModel::Pinhole {
            let places = if self.lenses.is_empty() { 1 } else { PLACES };
            let through = |i: usize| {
                let edit = self.edit(at.view, place(i), (camera, options));
                let mut input = input.clone();
                input.edit(move |ellipses| edit(ellipses).expect("the camera is a pinhole, as was asked above"));
                input
            };
            return (0..places).map(through).collect();
        }
        let Some(exposure) = self.exposures.get_mut(at.view) else { return vec![input] };
        let poses = motion::poses(&input.camera.cam_from_world, &twist(exposure, self.extent), SUB_EXPOSURES);
        let from = |cam_from_world| {
            let camera = Camera { cam_from_world, ..input.camera.clone() };
            RenderInput { camera, ..input.clone() }
        };
        poses.into_iter().map(from).collect()
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        for all in [&mut self.exposures, &mut self.readouts, &mut self.lenses] {
            let views = all.len();
            if let Some(learned) = all.get_mut(at.view) {
                learned.step_within(gradients, (FALL, views), at);
            }
        }
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        let parts = [("exposures", &self.exposures), ("readouts", &self.readouts), ("lenses", &self.lenses)];
        parts.into_iter().try_for_each(|(name, all)| to.save_part(name, |part| Learned::save_all(all, part)))
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        let Self { exposures, readouts, lenses, .. } = self;
        let parts = [("exposures", exposures), ("readouts", readouts), ("lenses", lenses)];
        parts.into_iter().try_for_each(|(name, all)| from.load_part(name, |part| Learned::load_all(all, part)))
    }
}

#[cfg(test)]
mod tests;
