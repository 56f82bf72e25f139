//! Options of adaptive density control, and those of each strategy that is made of it.

use super::Division;
use crate::density::Focus;

options! {
    /// Options of adaptive density control. Defaults are those of the original implementation unless stated otherwise.
    #[derive(Copy)]
    pub struct AdaptiveConfig {
        /// Steps between refinements.
        pub every: usize = 100,
        /// First step of refinement.
        pub from: usize = 500,
        /// Share of the run after which the number of Gaussians is fixed: 0.5.
        pub until_share: f64 = 0.5,
        /// Gaussians whose mean gradient at the projected centre, per unit of normalised device coordinates, exceeds this
        /// threshold are copied or split: 2e-4, and 8e-4 for absolute gradients.
        pub grad_threshold: f64 = 2e-4,
        /// Whether the gradient is AbsGS's (Ye et al. 2024): the sum of absolute values over the pixels, so that the gradients
        /// of the two edges of a Gaussian that blurs smaller detail do not cancel.
        pub absolute: bool = false,
        /// Largest size of a Gaussian that is copied instead of split, as a share of the scene extent: 0.01.
        pub split_scale: f64 = 0.01,
        /// Opacity below which Gaussians are removed: 0.005.
        pub prune_opacity: f64 = 0.005,
        /// Size above which Gaussians are removed after the first opacity reset, as a share of the scene extent: 0.1.
        pub prune_scale: f64 = 0.1,
        /// Steps between opacity resets, which remove floaters in front of the cameras: 3,000; 0 for never.
        pub reset_every: usize = 3_000,
        /// Largest number of Gaussians. At the cap only those with the largest gradients are copied or split.
        pub max_splats: usize = 1_000_000,
        /// How one Gaussian becomes two: as in the original.
        pub division: Division = Division::CloneOrSplit,
        /// Largest share of the Gaussians that one refinement copies or splits: none. Those with the largest gradients are chosen.
        /// With a share, the rows that are left up to `max_splats` are divided evenly among the refinements to come. Without one,
        /// a refinement may reach the cap at once.
        pub growth: Option<f64> = None,
        /// Share of the Gaussians that may exceed the threshold and still wait for a later refinement, with [`Self::growth`]: all. Where more
        /// of them do, as in a capture with few points, a refinement takes up to twice its share.
        pub waiting: f64 = 1.0,
        /// Largest ratio of a Gaussian's largest standard deviation to its middle one: 30. Needles far longer than wide show as
        /// streaks in views outside the training set. (Not in the original.)
        pub max_elongation: f64 = 30.0,
        /// The part of the scene that Gaussians are added to: all of it.
        pub focus: Option<Focus> = None,
    }
}

impl AdaptiveConfig {
    /// AbsGS: absolute gradients with the threshold that is common for them, in the same unit.
    pub fn absgrad() -> Self {
        Self { absolute: true, grad_threshold: 8e-4, ..Self::default() }
    }

    /// Growth by small shares from early on: every chosen Gaussian becomes two halves, which hardly change the picture. Opacities are
    /// not reset. Instead, a weight on the mean opacity in the loss ([`GRADUAL_OPACITY_WEIGHT`]) lets Gaussians fade that no photograph
    /// needs, as long as faint ones are removed. Without it, a capture without points may end behind one that is opaque.
    pub fn gradual() -> Self {
        Self {
            every: 50,
            from: 100,
            grad_threshold: 3e-4,
            reset_every: 0,
            division: Division::LongAxis,
            growth: Some(0.1),
            waiting: 0.15,
            ..Self::default()
        }
    }
}

/// The weight of the mean opacity in the loss for [`AdaptiveConfig::gradual`], that of MCMC (Kheradmand et al. 2024).
pub const GRADUAL_OPACITY_WEIGHT: f64 = 0.01;
