//! What happens while a photograph is taken, learnt for each beside the scene: the camera moves while the shutter is open
//! ([`motion`]), rows are read one after the other ([`motion::rolled`]), and the lens is focused at a distance ([`defocus`]).
//!
//! Each changes the ellipses on the screen, between [`project`](splat_op::project()) and [`tile`](splat_op::tile()), in the order
//! in which light meets lens, shutter and sensor. That is for pinholes. For other cameras motion is shown by averaging renders
//! from several poses on the way, which costs as many times as much; rolling shutters and defocus are refused.
//!
//! Defocus is averaged for pinholes too: over six places of the aperture, from each of which centres are moved by their circle of
//! confusion, with ellipses widened by what lies between the places. Widening alone spreads each Gaussian's light and not the
//! surface's: a disc of many pixels around splats of one leaves a wall half transparent. On the demo `--defocus` that gained
//! nothing.
//!
//! A motion blur says nothing of the sign of the motion, and at rest has no gradient: twists begin a little off zero. Renders
//! of the scene without these effects are sharp, which is what test views are compared with.

use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};
use splat_op::{
    Camera, CameraModel, Ellipses, Extras, Intrinsics, RenderOptions, Rendered, SplatError, Splats, blend, colours,
    project, tile,
};

use super::learned::{Learned, Moment};
use super::screen::ScreenError;
use super::{defocus, motion};
use crate::state::{State, StateError};

/// Which are simulated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpticsConfig {
    /// Motion while the shutter is open.
    pub motion: bool,
    /// Motion while rows are read.
    pub rolling: bool,
    /// A lens that is focused at a distance.
    pub defocus: bool,
}

impl OpticsConfig {
    /// Whether there is anything to do.
    pub fn any(self) -> bool {
        self.motion || self.rolling || self.defocus
    }
}

/// How far a twist can go in a run: rad, and extents of the scene.
const TWIST_REACH: [f32; 2] = [0.15, 0.1];

/// Where twists begin, rad: half a pixel at a focal length of 250 px.
const TWIST_START: f64 = 2e-3;

/// How far the logarithm of an aperture and the inverse of a distance in focus, per extent, can go in a run.
const LENS_REACH: [f32; 2] = [2.0, 0.6];

/// The aperture's radius at the beginning, extents of the scene.
const APERTURE_START: f64 = 0.02;

/// The last step by the first.
const FALL: f64 = 0.01;

/// Renders that are averaged where ellipses cannot be changed.
const SUB_EXPOSURES: usize = 5;

/// Places of the aperture: one in the middle, the others around it, in unit radii. Each stands for a sixth of the disc, and
/// their second moments with those of the sixths are the disc's.
const PLACES: usize = 6;

/// Where they are.
fn place(i: usize) -> [f32; 2] {
    if i == 0 {
        return [0.0; 2];
    }
    // A disc of radius 1 has 1/4 along each axis, one of a sixth of its area 1/24; the five outer places have the rest:
    // 5/6 · ρ²/2 = 1/4 − 1/24.
    let (radius, angle) = (0.5_f64.sqrt(), std::f64::consts::TAU * i as f64 / (PLACES - 1) as f64);
    [angle.cos(), angle.sin()].map(|share| (radius * share) as f32)
}

/// What was learnt of how the photographs of a run were taken.
pub struct Optics {
    extent: f64,
    /// `[2, 3]` each: `ω`, rad, and `τ`, extents, over the exposure.
    exposures: Vec<Learned<2>>,
    /// The same over the time in which the rows are read.
    readouts: Vec<Learned<2>>,
    /// `[1, 2]` each: the logarithm of the aperture's radius by the scene's extent, and the extent by the distance in focus.
    lenses: Vec<Learned<2>>,
}

/// The gradients of one step.
#[derive(Default)]
pub struct OpticsGradients {
    exposure: Option<Tensor<2>>,
    readout: Option<Tensor<2>>,
    lens: Option<Tensor<2>>,
}

impl Optics {
    /// For the photographs of these cameras, of a scene of `extent` whose middle is `distance` away from them.
    ///
    /// # Errors
    /// [`ScreenError::Lens`] if rolling shutters or defocus are asked for and a camera is no pinhole.
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
        // In all directions, one after the other by the golden angle.
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

    /// `[6]`: a twist in rad and scene units, tracked.
    fn twist(&self, learned: &Learned<2>) -> Tensor<1> {
        let rows = learned.tracked();
        let moved = rows.clone().narrow(0, 1, 1) * self.extent;
        Tensor::cat(vec![rows.narrow(0, 0, 1), moved], 0).reshape([6])
    }

    /// What the photograph `view` shows. As [`splat_op::render_view`] otherwise.
    ///
    /// # Errors
    /// Those of the operation's stages.
    pub fn render(
        &self,
        splats: &Splats,
        camera: &Camera,
        extras: &Extras,
        options: &RenderOptions,
        view: usize,
    ) -> Result<Rendered<3>, SplatError> {
        let pinhole = camera.intrinsics.model == CameraModel::Pinhole;
        let renders: Vec<Rendered<3>> = match self.exposures.get(view).filter(|_| !pinhole) {
            Some(exposure) => {
                let poses = motion::poses(&camera.cam_from_world, &self.twist(exposure), SUB_EXPOSURES);
                let renders = poses.into_iter().map(|cam_from_world| {
                    let camera = Camera { cam_from_world, ..camera.clone() };
                    self.render_once(splats, &camera, extras, options, (view, [0.0; 2]))
                });
                renders.collect::<Result<_, _>>()?
            }
            None if self.lenses.get(view).is_some() => {
                let renders = (0..PLACES).map(|i| self.render_once(splats, camera, extras, options, (view, place(i))));
                renders.collect::<Result<_, _>>()?
            }
            None => return self.render_once(splats, camera, extras, options, (view, [0.0; 2])),
        };
        let count = renders.len() as f32;
        let sum = renders.into_iter().reduce(|a, b| Rendered {
            colour: a.colour + b.colour,
            alpha: a.alpha + b.alpha,
            depth: a.depth.zip(b.depth).map(|(a, b)| a + b),
        });
        let Rendered { colour, alpha, depth } = sum.expect("there are several places and poses");
        Ok(Rendered { colour: colour / count, alpha: alpha / count, depth: depth.map(|depth| depth / count) })
    }

    fn render_once(
        &self,
        splats: &Splats,
        camera: &Camera,
        extras: &Extras,
        options: &RenderOptions,
        (view, place): (usize, [f32; 2]),
    ) -> Result<Rendered<3>, SplatError> {
        let mut projected = project(splats, camera, extras, options)?;
        match self.changed(projected.ellipses(), &camera.intrinsics, options, (view, place)) {
            Ok(ellipses) => projected = ellipses.pack(&camera.intrinsics)?,
            // Its motion is in the poses that are averaged.
            Err(ScreenError::Lens(_)) => {}
        }
        let features = colours(splats, camera)?;
        let tiles = tile(&projected, options)?;
        blend(&projected, &features, &tiles, extras, options)
    }

    /// The ellipses through this place of the aperture, in motion; an error for a lens.
    fn changed(
        &self,
        mut ellipses: Ellipses,
        camera: &Intrinsics,
        options: &RenderOptions,
        (view, place): (usize, [f32; 2]),
    ) -> Result<Ellipses, ScreenError> {
        if let Some(lens) = self.lenses.get(view) {
            let lens = lens.tracked();
            let log_aperture = lens.clone().narrow(1, 0, 1).reshape([1]) + self.extent.ln();
            let inverse_focus = lens.narrow(1, 1, 1).reshape([1]) / self.extent;
            let radii = defocus::confusion(&ellipses, camera, &log_aperture, &inverse_focus)?;
            let place = Tensor::<2>::from_floats([place], &radii.device());
            ellipses.mean2d = ellipses.mean2d + radii.clone() * place;
            ellipses = defocus::blurred(ellipses, radii / (PLACES as f64).sqrt());
        }
        if let Some(exposure) = self.exposures.get(view) {
            let velocity = motion::velocity(&ellipses, camera, &self.twist(exposure), options)?;
            ellipses = motion::blurred(ellipses, velocity);
        }
        if let Some(readout) = self.readouts.get(view) {
            let velocity = motion::velocity(&ellipses, camera, &self.twist(readout), options)?;
            ellipses = motion::rolled(ellipses, velocity, camera.height);
        }
        Ok(ellipses)
    }

    /// Takes the gradients for a view out of those of a loss.
    pub fn take_gradients(&self, view: usize, gradients: &mut burn::tensor::Gradients) -> OpticsGradients {
        let mut take = |all: &[Learned<2>]| all.get(view).and_then(|learned| learned.take_gradient(gradients));
        OpticsGradients { exposure: take(&self.exposures), readout: take(&self.readouts), lens: take(&self.lenses) }
    }

    /// Adam's step.
    pub fn step(&mut self, gradients: OpticsGradients, at: Moment) {
        let step = |all: &mut Vec<Learned<2>>, gradient: Option<Tensor<2>>| {
            let views = all.len();
            if let (Some(learned), Some(gradient)) = (all.get_mut(at.view), gradient) {
                learned.step_within(gradient, (FALL, views), at);
            }
        };
        step(&mut self.exposures, gradients.exposure);
        step(&mut self.readouts, gradients.readout);
        step(&mut self.lenses, gradients.lens);
    }

    /// Keeps what was learnt.
    ///
    /// # Errors
    /// None that is to be expected.
    pub fn save(&self, to: &mut State) -> Result<(), StateError> {
        let parts = [("exposures", &self.exposures), ("readouts", &self.readouts), ("lenses", &self.lenses)];
        for (name, learned) in parts {
            let mut part = State::default();
            Learned::save_all(learned, &mut part)?;
            to.put_part(name, part);
        }
        Ok(())
    }

    /// Goes on from what was kept.
    ///
    /// # Errors
    /// If something is missing or of another shape.
    pub fn load(&mut self, from: &mut State) -> Result<(), StateError> {
        let Self { exposures, readouts, lenses, .. } = self;
        for (name, learned) in [("exposures", exposures), ("readouts", readouts), ("lenses", lenses)] {
            let mut part = from.take_part(name);
            Learned::load_all(learned, &mut part)?;
            part.finish()?;
        }
        Ok(())
    }

    /// Bytes of the parameters and their moments.
    pub fn bytes(&self) -> usize {
        self.exposures.iter().chain(&self.readouts).chain(&self.lenses).map(Learned::bytes).sum()
    }
}

#[cfg(test)]
mod tests;
