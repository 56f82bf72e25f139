//! Learning rates, their decay, and when higher spherical harmonics switch on.

use glam::DVec3;
use splat_op::RenderOptions;

use crate::capture::spread::Spread;

/// Steps of a run of the original implementation (Kerbl et al. 2023), for which its learning rates and schedules are made.
pub const PUBLISHED_STEPS: usize = 30_000;

/// Largest factor of [`LearningRates::for_steps`], that of a run of 3,333 steps. In a run of 2,000 steps a factor of 4 gains 0.1 dB
/// more, and single scores fall by 1 dB.
const LARGEST_FACTOR: f64 = 3.0;

options! {
    /// Learning rates per group of parameters. The defaults are those of the original implementation (Kerbl et al. 2023),
    /// with its later rate for opacities. [`Self::for_steps`] gives those for a run of another length.
    #[derive(Copy)]
    pub struct LearningRates {
        /// Centres at step 0, as a share of the scene extent: 1.6e-4.
        pub means: f64 = 1.6e-4,
        /// Share of `means` that remains at the last step: 0.01.
        pub means_final_share: f64 = 0.01,
        /// Logarithms of the standard deviations: 5e-3.
        pub scales: f64 = 5e-3,
        /// Quaternions: 1e-3.
        pub rotations: f64 = 1e-3,
        /// Degree-0 coefficients: 2.5e-3.
        pub sh_dc: f64 = 2.5e-3,
        /// Higher coefficients: 1.25e-4, a twentieth of `sh_dc`, so that view-dependence comes after colour.
        pub sh_rest: f64 = 1.25e-4,
        /// Logits of the opacities: 0.025.
        pub opacities: f64 = 0.025,
        /// Share of all rates but `means` that remains at the last step: 1.
        pub others_final_share: f64 = 1.0,
    }
}

impl LearningRates {
    /// The rates for a run of `steps`. With `f = √(30,000 / steps)`, from 1 to 3, all rates begin `f` times as large as the
    /// published ones, so that a short run covers more of the way. The centres' rate falls to its published share; all others,
    /// which are constant in the original, fall to `1 / f` of the published rates. A run of 30,000 steps or more has the
    /// published rates. `docs/STRATEGIES.md` gives what this gains.
    pub fn for_steps(steps: usize) -> Self {
        let factor = (PUBLISHED_STEPS as f64 / steps.max(1) as f64).sqrt().clamp(1.0, LARGEST_FACTOR);
        Self { others_final_share: factor.powi(-2), ..Self::default().times(factor) }
    }

    /// The rates after the share `done` of a run: `initial · final_share^done`, the schedule of Plenoxels (Fridovich-Keil et al. 2022), which
    /// 3D Gaussian splatting adopted for the centres without its delay.
    pub fn after(self, done: f64) -> Self {
        let means = self.means * self.means_final_share.powf(done);
        Self { means, ..self.times(self.others_final_share.powf(done)) }
    }

    /// Returns the rates for steps of `views` photographs each: `√views` times these (see [`crate::optim::Adam::for_batch`]).
    pub fn for_batch(self, views: usize) -> Self {
        self.times((views as f64).sqrt())
    }

    fn times(self, factor: f64) -> Self {
        Self {
            means: self.means * factor,
            scales: self.scales * factor,
            rotations: self.rotations * factor,
            sh_dc: self.sh_dc * factor,
            sh_rest: self.sh_rest * factor,
            opacities: self.opacities * factor,
            ..self
        }
    }
}

/// Steps between two degrees in the schedule of the original implementation.
pub const STEPS_PER_SH_DEGREE: usize = 1_000;

/// Steps between two degrees for a run of `steps`: [`STEPS_PER_SH_DEGREE`], or an eighth of a run of less than 8,000.
pub fn sh_every_for(steps: usize) -> usize {
    STEPS_PER_SH_DEGREE.min(steps / 8).max(1)
}

/// Degree of the spherical harmonics in use at `step`. It rises by one every `every` steps (usually [`STEPS_PER_SH_DEGREE`]) up
/// to `largest`, so that diffuse colour settles first (Kerbl et al. 2023, section 7.1). With `every` = 0, all degrees are in
/// use from the start.
pub fn sh_degree_at(step: usize, every: usize, largest: usize) -> usize {
    step.checked_div(every).map_or(largest, |degree| degree.min(largest))
}

/// The scene extent, the radius that learning rates and density control are relative to: 1.1 × the largest distance of a
/// camera's centre from the mean of all centres, as in the original implementation, but without strays: centres that are not finite, or
/// further than five times as far from the median as seven tenths of them. Same unit as `centres`.
///
/// One camera, none, or several at one place have no extent. The function then returns 1, which uses the scene's unit as it is. The
/// remedy for a wrong unit is to scale the capture.
pub fn scene_extent(centres: &[DVec3]) -> f64 {
    let Some(Spread { middle, radius, .. }) = Spread::of(centres) else { return 1.0 };
    let extent = 1.1 * radius;
    // Rounding puts coincident centres a few ulps apart, which must not count as an extent.
    if extent > 1e-12 * middle.length() && extent.is_finite() { extent } else { 1.0 }
}

/// The near plane of a scene of `extent` (see [`scene_extent`]), scene units: the value of [`RenderOptions::standard`], or a hundredth of
/// the extent if that is less. A scene of a few millimetres, in metres, would lie entirely before a near plane at a centimetre.
pub fn near_plane(extent: f64) -> f64 {
    RenderOptions::standard().near * extent.min(1.0)
}

#[cfg(test)]
mod tests;
