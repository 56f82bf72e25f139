//! Effects of cameras and scenes beyond matte Gaussians under a constant light, simulated only where a scene calls for them.
//!
//! [`Survey`] gathers the evidence, [`Plan`] decides, and each effect is a file of ordinary tensor code. An effect that is
//! off does not exist: no parameter, no tensor, no launch. An effect is a type that implements [`Effect`], one of the user's own
//! too, and a run has an [`EffectStack`] of them.

pub mod background;
mod centred;
pub mod defocus;
pub mod depth;
mod effect;
pub mod exposure;
pub mod grid;
mod learned;
pub mod masks;
pub mod motion;
pub mod optics;
pub mod plan;
pub mod pose;
pub mod screen;
pub mod smoothing;
mod stack;
pub mod survey;
#[cfg(test)]
mod testing;

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

pub(crate) use self::effect::mean_of;
use self::effect::saved_bytes;
pub use self::effect::{Effect, RenderInput};
pub use self::learned::{Falling, Learned, Moment};
pub use self::plan::Plan;
pub use self::stack::EffectStack;
pub use self::survey::Survey;

/// The effects of this library, which can be switched on and off. How far colours depend on the direction of view is set by
/// [`TrainConfig::sh_degree`](crate::trainer::TrainConfig::sh_degree).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EffectKind {
    /// The same thing is seen at very different sizes: splats smaller than a pixel are dimmed, and none is finer than the
    /// photographs can tell.
    Antialias,
    /// Photographs have transparent parts, which are trained over a background of another colour at each step.
    Alpha,
    /// Photographs differ in brightness and white balance: each has an affine colour map of its own.
    Exposure,
    /// Photographs were processed place by place: each has a grid of such maps, instead of one.
    BilateralGrid,
    /// Masks say which pixels of the photographs count.
    Masks,
    /// Poses do not explain the photographs: each camera is moved with the scene.
    PoseRefinement,
    /// Much of what is seen is too far away for any parallax: light from infinity is learnt.
    Environment,
    /// Pictures are smeared: the camera moved while the shutter was open.
    MotionBlur,
    /// Rows were exposed one after the other while the camera moved.
    RollingShutter,
    /// An open aperture: what is not at the distance in focus is blurred. Asked for by name alone.
    Defocus,
    /// Few photographs show the scene, or depth maps came with them: known depths hold it in place.
    DepthSupervision,
}

impl EffectKind {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::Antialias,
        Self::Alpha,
        Self::Exposure,
        Self::BilateralGrid,
        Self::Masks,
        Self::PoseRefinement,
        Self::Environment,
        Self::MotionBlur,
        Self::RollingShutter,
        Self::Defocus,
        Self::DepthSupervision,
    ];

    /// As the command line and reports call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Antialias => "antialias",
            Self::Alpha => "alpha",
            Self::Exposure => "exposure",
            Self::BilateralGrid => "bilateral-grid",
            Self::Masks => "masks",
            Self::PoseRefinement => "pose-refinement",
            Self::Environment => "environment",
            Self::MotionBlur => "motion-blur",
            Self::RollingShutter => "rolling-shutter",
            Self::Defocus => "defocus",
            Self::DepthSupervision => "depth-supervision",
        }
    }

    /// The name of what simulates it in an [`EffectStack`]; none has that of masks, which come with the photographs.
    pub(crate) const fn in_stack(self) -> &'static str {
        match self {
            Self::MotionBlur | Self::RollingShutter | Self::Defocus => "optics",
            _ => self.name(),
        }
    }
}

impl fmt::Display for EffectKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
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
