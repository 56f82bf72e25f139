//! Effects of cameras and scenes beyond matte Gaussians under a constant light, simulated only where a scene calls for them.
//!
//! [`Survey`] gathers the evidence, [`Plan`] decides, and each effect is a file of ordinary tensor code. An effect that is
//! off does not exist: no parameter, no tensor, no launch. [`Applied`] is what a training loop sees of them.

mod applied;
pub mod defocus;
pub mod exposure;
pub mod masks;
pub mod motion;
pub mod plan;
pub mod screen;
pub mod survey;
#[cfg(test)]
mod testing;

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

pub use self::applied::Applied;
pub use self::plan::Plan;
pub use self::survey::Survey;

/// The effects that can be switched on and off. How far colours depend on the direction of view is set by
/// [`TrainConfig::sh_degree`](crate::trainer::TrainConfig::sh_degree).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Effect {
    /// The same thing is seen at very different sizes: splats smaller than a pixel are dimmed.
    Antialias,
    /// Photographs have transparent parts, which are trained over a background.
    Alpha,
    /// Photographs differ in brightness and white balance: each has an affine colour map of its own.
    Exposure,
    /// Masks say which pixels of the photographs count.
    Masks,
}

impl Effect {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Antialias, Self::Alpha, Self::Exposure, Self::Masks];

    /// As the command line and reports call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Antialias => "antialias",
            Self::Alpha => "alpha",
            Self::Exposure => "exposure",
            Self::Masks => "masks",
        }
    }
}

impl fmt::Display for Effect {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

impl FromStr for Effect {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|effect| effect.name() == name)
            .ok_or_else(|| format!("there is no effect {name:?}, expected one of {}", names()))
    }
}
