//! The background behind the Gaussians: a constant colour, a random colour for each step, a learned colour, or a learned environment.
//!
//! - **A random colour for each step** (as in training on the NeRF-synthetic scenes by successors of Mildenhall et al.
//!   2020) prevents colours from hiding in transparent parts: a scene that looks right over every colour has the
//!   photograph's alpha. An opaque photograph then requires opaque Gaussians everywhere.
//! - **A learned colour** is one parameter of three numbers, composited by the kernel.
//! - **An environment** is light from infinitely far away: `0.5 + Σₖ Yₖ(d) cₖ` with `d` the viewing direction of a pixel
//!   and `Yₖ` the real spherical harmonics of [`mod@splat_op::sh`]. It models skies, which have no parallax and would
//!   otherwise need Gaussians at some distance. [`splat_op::environment`] composites the render over it.
//!
//! Directions use the photographs' given poses, also while poses are refined.

use std::path::Path;

use burn::tensor::{Device, Gradients, Tensor, TensorData};
use glam::{DAffine3, DVec2, Vec3};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use splat_op::sh::sh_degree;
use splat_op::{
    Camera, Extras, Intrinsics, RenderOptions, Rendered, SplatError, Splats, environment, mixed, render_view,
};

use super::{Effect, EffectContext, EffectKind, Falling, Leaf, Learned, RenderInput};
use crate::gaussians::{Gaussians, values_of};
use crate::state::{State, StateError};
use crate::{FileError, json};

/// The kind of background of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Backdrop {
    /// [`TrainConfig::background`](crate::trainer::TrainConfig::background) at every step.
    #[default]
    Fixed,
    /// A random colour for each step, also behind the photograph's transparent parts. Scores and files use
    /// [`TrainConfig::background`](crate::trainer::TrainConfig::background).
    Random,
    /// One learned colour. For photographs without alpha.
    Learned,
    /// A learned environment in spherical harmonics of this degree, 0 to 4. For photographs without alpha.
    Environment {
        /// The degree. Degree 2 can represent the sky above, the sun's direction and the falloff of light around it.
        degree: usize,
    },
}

/// Learning rates of colours and coefficients, as for exposures.
const RATE: Falling = Falling { from: 0.01, to: 0.001 };

/// Memory for the viewing directions of each camera's pixels. Beyond it they are computed at each step.
const CACHE_BYTES: usize = 256 << 20;

/// A background in a file or on the command line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// RGB, 0 to 1.
    Colour([f32; 3]),
    /// Coefficients in the order of the harmonics, RGB.
    Environment(Vec<[f32; 3]>),
}

/// Largest accepted file. A background is a few hundred bytes.
const LARGEST_FILE: u64 = 1 << 20;

impl Background {
    /// Reads a file that [`Self::to_json`] wrote.
    ///
    /// # Errors
    /// If the file cannot be read or is not a background.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let content = |found: String| {
            let reason = format!(
                "{found}, expected the `background.json` that a run writes beside its scene: {{\"colour\": [r, g, b]}} or \
                 {{\"environment\": [[r, g, b], ...]}} with 1, 4, 9, 16 or 25 coefficients, all finite"
            );
            FileError::new(path, reason)
        };
        let found: Self = json::read(path, LARGEST_FILE, content)?;
        match &found {
            Self::Environment(coefficients) if sh_degree(coefficients.len()).is_none() => {
                Err(content(format!("{} coefficients", coefficients.len())))
            }
            found if found.values().any(|value| !value.is_finite()) => {
                Err(content("a number that is not finite".into()))
            }
            _ => Ok(found),
        }
    }

    /// The background in the format of its file.
    ///
    /// # Errors
    /// If a number is not finite, which JSON cannot represent.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string_pretty(self)
    }

    fn values(&self) -> impl Iterator<Item = f32> {
        let all = match self {
            Self::Colour(colour) => std::slice::from_ref(colour),
            Self::Environment(coefficients) => coefficients,
        };
        all.as_flattened().iter().copied()
    }

    /// The colour for the render: black if an environment is added later.
    pub fn colour(&self) -> [f32; 3] {
        match self {
            Self::Colour(colour) => *colour,
            Self::Environment(_) => [0.0; 3],
        }
    }

    /// Composites a render over [`Self::colour`], `[H, W, 3]`, with its alpha `[H, W, 1]`, over this background. Not tracked.
    pub fn behind(
        &self,
        image: Tensor<3>,
        alpha: Tensor<3>,
        camera: &Intrinsics,
        cam_from_world: &DAffine3,
    ) -> Tensor<3> {
        let Self::Environment(coefficients) = self else { return image };
        let device = image.device();
        let coefficients = TensorData::new(coefficients.as_flattened().to_vec(), [coefficients.len(), 3]);
        let directions = directions_of(camera, cam_from_world, &device);
        over(&image, &alpha, &directions, &Tensor::from_data(coefficients, &device))
    }

    /// Renders splats over the background.
    ///
    /// # Errors
    /// If the renderer refuses the scene.
    pub fn render(
        &self,
        splats: &Splats,
        intrinsics: &Intrinsics,
        cam_from_world: &DAffine3,
        options: &RenderOptions,
    ) -> Result<Rendered<3>, SplatError> {
        let device = splats.means.device();
        let extras = Extras::default().with_background(Tensor::from_floats(self.colour(), &device));
        let mut picture = render_view(splats, &Camera::new(*intrinsics, cam_from_world, &device), &extras, options)?;
        picture.colour = self.behind(picture.colour, picture.alpha.clone(), intrinsics, cam_from_world);
        Ok(picture)
    }
}

/// `[3, H, W]`: the unit viewing directions of a camera's pixels, in the world frame.
pub(crate) fn directions_of(camera: &Intrinsics, cam_from_world: &DAffine3, device: &Device) -> Tensor<3> {
    let (width, height) = (camera.width, camera.height);
    let (projector, world_from_cam) = (camera.projector(), cam_from_world.matrix3.transpose());
    let pixels = (0..height * width).into_par_iter().map(|i| {
        let px = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        (world_from_cam * projector.cam_from_px(px).normalize()).as_vec3()
    });
    let directions: Vec<Vec3> = pixels.collect();
    let values: Vec<f32> = (0..3).flat_map(|axis| directions.iter().map(move |direction| direction[axis])).collect();
    Tensor::from_data(TensorData::new(values, [3, height, width]), device)
}

fn over(image: &Tensor<3>, alpha: &Tensor<3>, directions: &Tensor<3>, coefficients: &Tensor<2>) -> Tensor<3> {
    environment::over(image, alpha, directions, coefficients).expect("a render of this camera, on one device")
}

/// A background with a random colour for each step.
pub struct RandomBackground;

impl Effect for RandomBackground {
    fn name(&self) -> &'static str {
        EffectKind::Alpha.name()
    }

    fn draw(&mut self, rng: &mut dyn Rng) -> Option<[f32; 3]> {
        Some([0, 1, 2].map(|_| rng.random_range(0.0..1.0)))
    }
}

/// The functions of an effect whose one parameter is a field.
macro_rules! learns {
    ($field:ident) => {
        fn leaves(&mut self, _: EffectContext) -> Vec<Leaf> {
            vec![self.$field.leaf()]
        }

        fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
            self.$field.step(gradients, RATE.at(at.step, at.steps), at.verdict);
        }

        fn save(&self, to: &mut State) -> Result<(), StateError> {
            self.$field.save(to)
        }

        fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
            self.$field.load(from)
        }
    };
}

/// A background with one learned colour.
pub struct LearnedBackground {
    /// `[3]`
    colour: Learned<1>,
}

impl LearnedBackground {
    /// Starts at the colour `start`.
    pub fn new(start: [f32; 3], device: &Device) -> Self {
        Self { colour: Learned::new(Tensor::from_floats(start, device)) }
    }
}

impl Effect for LearnedBackground {
    fn name(&self) -> &'static str {
        "learned-background"
    }

    fn before(&mut self, input: &mut RenderInput, _: &Gaussians, _: EffectContext) {
        input.extras.background = Some(self.colour.tracked());
    }

    learns!(colour);

    fn background(&self) -> Option<Background> {
        let values = values_of(self.colour.value());
        Some(Background::Colour([values[0], values[1], values[2]].map(|value| value.clamp(0.0, 1.0))))
    }
}

/// A learned environment in spherical harmonics.
///
/// Photographs of one camera share the viewing directions in the camera's frame, which each rotates into the world's.
pub struct Environment {
    /// `[(degree+1)², 3]`, world frame.
    coefficients: Learned<2>,
    /// `[3, 3]` by photograph: `world_from_cam`.
    rotations: Vec<Tensor<2>>,
    /// `[3, H, W]` by camera, in its frame.
    cache: Vec<(Intrinsics, Tensor<3>)>,
    cached_bytes: usize,
}

impl Environment {
    /// Grey light around photographs of the given poses, `cam_from_world`, in harmonics of `degree`, 0 to 4.
    pub fn new(degree: usize, poses: &[DAffine3], device: &Device) -> Self {
        let coefficients = Learned::new(Tensor::zeros([(degree + 1) * (degree + 1), 3], device));
        // Columns of a pose are rows of its inverse.
        let rotation = |pose: &DAffine3| Tensor::from_floats(pose.matrix3.as_mat3().to_cols_array_2d(), device);
        let rotations = poses.iter().map(rotation).collect();
        Self { coefficients, rotations, cache: Vec::new(), cached_bytes: 0 }
    }

    /// The render over black of a photograph's camera, composited over the environment.
    fn behind(&mut self, image: Tensor<3>, alpha: Tensor<3>, view: usize, camera: &Intrinsics) -> Tensor<3> {
        let directions = mixed(self.rotations[view].clone(), self.directions_of(camera));
        over(&image, &alpha, &Tensor::from_inner(directions), &self.coefficients.tracked())
    }

    fn directions_of(&mut self, camera: &Intrinsics) -> Tensor<3> {
        if let Some((_, directions)) = self.cache.iter().find(|(of, _)| of == camera) {
            return directions.clone();
        }
        let device = self.coefficients.value().device();
        let directions = directions_of(camera, &DAffine3::IDENTITY, &device);
        let bytes = directions.shape().num_elements() * size_of::<f32>();
        if self.cached_bytes + bytes <= CACHE_BYTES {
            self.cached_bytes += bytes;
            self.cache.push((*camera, directions.clone()));
        }
        directions
    }
}

impl Effect for Environment {
    fn name(&self) -> &'static str {
        EffectKind::Environment.name()
    }

    fn before(&mut self, input: &mut RenderInput, _: &Gaussians, _: EffectContext) {
        let device = self.coefficients.value().device();
        input.extras.background = Some(Tensor::zeros([3], &device));
    }

    fn image(&mut self, image: Tensor<3>, input: &RenderInput, picture: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        self.behind(image, picture.alpha.clone(), at.view, &input.camera.intrinsics)
    }

    learns!(coefficients);

    fn background(&self) -> Option<Background> {
        let values = values_of(self.coefficients.value());
        Some(Background::Environment(values.as_chunks::<3>().0.to_vec()))
    }
}

#[cfg(test)]
mod tests;
