//! Effects of cameras and scenes that matte Gaussians under constant light do not model, simulated only where a scene needs them.
//!
//! [`Survey`] gathers the evidence, [`Plan`] decides, and each effect is a file of ordinary tensor code. An effect that is
//! off adds no parameter, no tensor and no launch. An effect is a type that implements [`Effect`], which may be the user's
//! own. A run has an [`EffectStack`] of effects.

pub mod background;
pub mod depth;
mod effect;
pub mod exposure;
pub mod grid;
mod leaf;
mod learned;
mod maps;
pub mod motion;
mod network;
pub mod optics;
pub mod plan;
pub mod pose;
pub mod smoothing;
mod stack;
pub mod survey;
#[cfg(test)]
mod testing;

use std::str::FromStr;

use serde::Serialize;

pub(crate) use self::effect::mean_of;
pub use self::effect::{Effect, RenderInput};
pub use self::leaf::Leaf;
pub(crate) use self::leaf::stand_in;
pub use self::learned::{EffectContext, Falling, Learned};
pub use self::network::Network;
pub use self::plan::Plan;
pub use self::stack::EffectStack;
pub use self::survey::Survey;
pub use crate::capture::masks;

named! {
    /// The effects of this library that can be switched on and off. How strongly colours depend on the viewing direction is set
    /// by [`TrainConfig::sh_degree`](crate::trainer::TrainConfig::sh_degree).
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum EffectKind {
        /// The same surface is seen at very different sizes: splats smaller than a pixel are dimmed, and no splat is finer than
        /// the sampling of the photographs.
        Antialias = "antialias",
        /// Photographs have transparent parts: each step composites them over another background colour.
        Alpha = "alpha",
        /// Photographs differ in brightness and white balance: each has its own affine colour map.
        Exposure = "exposure",
        /// Photographs were processed locally: each has a grid of affine colour maps.
        BilateralGrid = "bilateral-grid",
        /// Masks select the pixels of the photographs that count.
        Masks = "masks",
        /// Poses do not explain the photographs: each camera is moved with the scene.
        PoseRefinement = "pose-refinement",
        /// Much of the scene is too far away for parallax: light from infinity is learned.
        Environment = "environment",
        /// Photographs are blurred because the camera moved while the shutter was open.
        MotionBlur = "motion-blur",
        /// Rows were exposed one after the other while the camera moved.
        RollingShutter = "rolling-shutter",
        /// Few photographs show the scene, or it comes with depth maps: known depths constrain the scene.
        DepthSupervision = "depth-supervision",
    }
}

impl FromStr for EffectKind {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|effect| effect.name() == name)
            .ok_or_else(|| format!("there is no effect {name:?}, expected one of {}", names()))
    }
}
