//! Effects during the exposure, learned for each photograph along with the scene: the camera moves while the shutter is
//! open, rows are read one after the other, and the lens has a focus distance.
//!
//! Each effect changes the projected ellipses by an operation of [`splat_op::optics`], in the order in which light passes lens, shutter
//! and sensor. That holds for pinholes. For other cameras, motion blur averages renders from several poses along the motion
//! ([`motion::poses`]), at a multiple of the cost. Rolling shutters and defocus are not supported for them.
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
use splat_op::optics::{AperturePart, blurred, defocused, rolled};
use splat_op::{Camera, CameraModel, Intrinsics, Projected, SplatError};
use thiserror::Error;

use super::learned::{EffectContext, Learned};
use super::{Effect, Leaf, RenderInput, motion};
use crate::state::{State, StateError};

/// The camera has a lens, and rolling shutters and defocus are simulated for pinholes only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "the camera model is {0:?}, and rolling shutters and defocus are simulated for Pinhole only: undistort the photographs, or train \
     without `rolling-shutter` and `defocus`"
)]
pub struct LensError(pub CameraModel);

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

/// Reach in a run of the aperture's logarithm.
const APERTURE_REACH: f64 = 2.0;

/// Reach in a run of the inverse focus distance, per extent.
const FOCUS_REACH: f64 = 0.6;

/// Initial radius of the aperture, scene extents: wide open. It closes where photographs are sharp, and would not open again where
/// large Gaussians, blurred already, have taken the place of the blur.
const APERTURE_START: f64 = 0.06;

/// Ratio of the last step size to the first.
const FALL: f64 = 0.01;

/// Number of renders that are averaged where ellipses cannot be changed.
const SUB_EXPOSURES: usize = 5;

/// Number of positions in the aperture: one in the middle, the others around it, in unit radii. Each represents a sixth of
/// the disc. The second moments of the positions and of the sixths add up to the disc's.
const PLACES: usize = 6;

/// Part `i` of the aperture.
fn part(i: usize) -> AperturePart {
    let deviation = AperturePart::WHOLE.deviation / (PLACES as f64).sqrt();
    if i == 0 {
        return AperturePart { place: [0.0; 2], deviation };
    }
    // A disc of radius 1 has variance 1/4 along each axis, a disc of a sixth of its area 1/24. The five outer positions
    // supply the rest: 5/6 · ρ²/2 = 1/4 − 1/24.
    let (radius, angle) = (0.5_f64.sqrt(), std::f64::consts::TAU * i as f64 / (PLACES - 1) as f64);
    AperturePart { place: [radius * angle.cos(), radius * angle.sin()], deviation }
}

/// The learned optics of all photographs of a run.
pub struct Optics {
    extent: f64,
    /// `[2, 3]` each: `ω`, rad, and `τ`, scene extents, over the exposure.
    exposures: Vec<Learned<2>>,
    /// `[2, 3]` each: `ω`, rad, and `τ`, scene extents, over the readout of the rows.
    readouts: Vec<Learned<2>>,
    /// `[1, 1]`, with defocus: the logarithm of the aperture's radius divided by the scene extent. Photographs share it: a photograph
    /// alone is visited too rarely to find both its aperture and its focus.
    aperture: Option<Learned<2>>,
    /// `[1, 1]` each: the scene extent divided by the focus distance.
    foci: Vec<Learned<2>>,
}

impl Optics {
    /// Parameters for photographs of these cameras, of a scene of `extent` whose middle is at a distance of `distance`.
    ///
    /// # Errors
    /// [`LensError`] if rolling shutters or defocus are selected and a camera is not a pinhole.
    pub fn new(
        config: OpticsConfig,
        cameras: &[Intrinsics],
        (extent, distance): (f64, f64),
        device: &Device,
    ) -> Result<Self, LensError> {
        let lens = cameras.iter().map(|camera| camera.model).find(|model| *model != CameraModel::Pinhole);
        if let Some(model) = lens.filter(|_| config.rolling || config.defocus) {
            return Err(LensError(model));
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
        let number = |value: f64| Tensor::<2>::from_floats([[value as f32]], device);
        Ok(Self {
            extent,
            exposures: learned(config.motion, &twist, twists.clone()),
            readouts: learned(config.rolling, &|_| Tensor::zeros([2, 3], device), twists),
            aperture: config.defocus.then(|| Learned::reaching(number(APERTURE_START.ln()), number(APERTURE_REACH))),
            foci: learned(config.defocus, &|_| number(extent / distance), number(FOCUS_REACH)),
        })
    }

    /// The changes of the ellipses in a render of `view`, one for each part of the aperture. `margin` is that of the Jacobian.
    fn edits(
        &mut self,
        view: usize,
        margin: f64,
    ) -> impl Iterator<Item = impl Fn(Projected) -> Result<Projected, SplatError> + use<>> + use<> {
        let extent = self.extent;
        let lens = self.aperture.as_mut().zip(self.foci.get_mut(view)).map(|(aperture, focus)| {
            Tensor::cat(vec![aperture.tracked() + extent.ln(), focus.tracked() / extent], 1).reshape([2])
        });
        let exposure = self.exposures.get_mut(view).map(|exposure| twist(exposure, extent));
        let readout = self.readouts.get_mut(view).map(|readout| twist(readout, extent));
        (0..if lens.is_some() { PLACES } else { 1 }).map(move |i| {
            let (lens, exposure, readout) = (lens.clone(), exposure.clone(), readout.clone());
            move |mut projected| {
                if let Some(lens) = &lens {
                    projected = defocused(&projected, lens, part(i))?;
                }
                if let Some(exposure) = &exposure {
                    projected = blurred(&projected, exposure, margin)?;
                }
                if let Some(readout) = &readout {
                    projected = rolled(&projected, readout, margin)?;
                }
                Ok(projected)
            }
        })
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
            input.edit_each(self.edits(at.view, margin));
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
        let of_view = [&mut self.exposures, &mut self.readouts, &mut self.foci];
        let of_view = of_view.into_iter().filter_map(|all| all.get_mut(at.view)).map(Learned::leaf);
        self.aperture.as_mut().map(Learned::leaf).into_iter().chain(of_view).collect()
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        if let Some(aperture) = &mut self.aperture {
            aperture.step_within(gradients, (FALL, 1), at);
        }
        for all in [&mut self.exposures, &mut self.readouts, &mut self.foci] {
            let views = all.len();
            if let Some(learned) = all.get_mut(at.view) {
                learned.step_within(gradients, (FALL, views), at);
            }
        }
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        if let Some(aperture) = &self.aperture {
            to.in_part("aperture", |part| aperture.save(part))?;
        }
        let parts = [("exposures", &self.exposures), ("readouts", &self.readouts), ("foci", &self.foci)];
        parts.into_iter().try_for_each(|(name, all)| to.in_part(name, |part| Learned::save_all(all, part)))
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        if let Some(aperture) = &mut self.aperture {
            from.load_part("aperture", |part| aperture.load(part))?;
        }
        let Self { exposures, readouts, foci, .. } = self;
        let parts = [("exposures", exposures), ("readouts", readouts), ("foci", foci)];
        parts.into_iter().try_for_each(|(name, all)| from.load_part(name, |part| Learned::load_all(all, part)))
    }
}

#[cfg(test)]
mod tests;
