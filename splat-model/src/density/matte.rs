//! Which Gaussians need no directional colour. Each is asked every time the degree of the spherical harmonics rises, the first
//! time excepted, and once more when the last degree has been in use for as long: by then it has had the time of one degree to
//! show that its colour varies. One that is matte stays so, and so do its children.
//!
//! The colour in direction `d` is `0.5 + Σₖ cₖ Yₖ(d)`, clamped at zero. The `Yₖ` are orthonormal on the unit sphere, so that over
//! all directions the mean of the sum is `c₀ Y₀`, and its mean squared distance from that (Parseval)
//!
//! ```text
//! 1/4π ∫ (Σₖ₌₁ cₖ Yₖ(d))² dd  =  1/4π Σₖ₌₁ cₖ²
//! ```
//!
//! Its root, of the channel where it is largest, is what is compared. In one direction the difference may be larger, but by
//! `Σₖ₌₁ Yₖ(d)² = ((degree+1)² − 1)/4π` (the addition theorem) and Cauchy–Schwarz never by more than the root of
//! `(degree+1)² − 1`: 1.7 times at degree 1, 3.9 times at degree 3. Directions that no camera looks from count like all others.

use burn::tensor::Tensor;

use crate::gaussians::{Gaussians, values_of};

/// How much the colours of Gaussians vary with the direction, `[M]`, from their coefficients, `[M, (degree+1)², 3]`: the root mean
/// square over all directions, before the clamp, of the channel that varies most. In units of colour, of which 1/255 is one
/// level of an 8-bit picture. Zero at degree 0.
pub fn variation(sh: Tensor<3>) -> Tensor<1> {
    let [count, coefficients, _] = sh.dims();
    if coefficients == 1 {
        return Tensor::zeros([count], (&sh.device(), sh.dtype()));
    }
    let squares = sh.narrow(1, 1, coefficients - 1).square().sum_dim(1);
    (squares.max_dim(2) / (4.0 * std::f64::consts::PI)).sqrt().reshape([count])
}

/// Whether colours can be compared with `below`: it is finite and not negative.
pub fn is_threshold(below: f64) -> bool {
    below >= 0.0 && below.is_finite()
}

/// The Gaussians of a scene whose colour varies by less than `below` (see [`variation`]) and which are not matte yet, in ascending
/// order. Those with coefficients that are not numbers are none of them.
pub fn hardly_varying(gaussians: &Gaussians, below: f64) -> Vec<u32> {
    if gaussians.directional() == 0 {
        return Vec::new();
    }
    let varies = values_of(variation(gaussians.sh.val().inner()));
    (0u32..).zip(varies).filter(|(_, varies)| f64::from(*varies) < below).map(|(row, _)| row).collect()
}

/// Whether Gaussians are asked after `steps` steps, where the degree rises by one every `every` up to `largest`: before it rises
/// to 2 and to each above, and when it would rise once more. Never where all degrees are there from the start, with `every` = 0.
pub fn asks_after(steps: usize, every: usize, largest: usize) -> bool {
    every > 0 && steps.is_multiple_of(every) && largest > 0 && (2..=largest + 1).contains(&(steps / every))
}

#[cfg(test)]
mod tests;
