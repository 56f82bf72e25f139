//! Adam's step with moments of 8 bits instead of 32: an approximation of [the step in f32](super).
//!
//! A step decodes the moments of a number, computes the step in f32, and encodes the new moments. One code of 16 bits holds both:
//!
//! - `v` as a float without a sign, in the lower 9 bits: 7 bits of its exponent and the first 2 of its fraction. The smallest above 0
//!   is 2⁻⁹⁰, and zero is the code 0.
//! - `m` as a level `q` of 6 bits and a sign: `m = ± (q / Q)² · reach · √v`, with `Q` the largest level and `v` as it is stored. By Cauchy and
//!   Schwarz `|m| ≤ √v / √(1 − β₁² / β₂)`, so that every `m` has a level. `√v · (q / Q)²` is what a step is proportional to, so an error
//!   of `m` is an error of the step and never more than a share of the learning rate. The levels lie closer near zero, where most are.
//!
//! In a step `v` loses a thousandth, less than the distance of two codes: rounding to the nearest code would hold it where it is. Both
//! moments are therefore rounded up or down in proportion to their distances (Gupta et al. 2015, "Deep Learning with Limited Numerical
//! Precision", section 3.1). The threshold is not drawn but computed from the index of the number and the step's:
//! `hash(index) + step · φ` modulo 1, so that a run repeats bit for bit. The steps of a number take thresholds that are spread evenly.
//! With gradients of noise, the error of a step is then a sixth of it, where thresholds drawn independently give a fifth. The price is
//! that a rounding depends on the one before: without gradients, `v` falls in 1,000 steps to 0.33 of what it was, where f32 has 0.37.
//!
//! Codes are in words of 32 bits, row by row of the parameter: word `j` of a row holds the codes `2j`, in its lower half, and `2j + 1`.
//! Codes beyond the end of a row are 0. A row of zeros has no history. Rows may be moved and appended, and a row
//! that grows at its end keeps its codes.

mod cpu;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
#[cfg(test)]
mod tests;

use burn::tensor::{Int, Tensor};
pub use cpu::{HostState, step_on_host};

use super::Factors;
use crate::backend::apply;

/// Number of codes of a word.
pub(crate) const CODES_PER_WORD: u32 = 2;

/// Number of bits of a code: `v` in the lower ones, then the level of `m`, then its sign.
pub(crate) const CODE_BITS: u32 = 16;

/// Number of bits of `v`.
pub(crate) const SECOND_BITS: u32 = 9;

/// Number of bits of the fraction of `v`.
pub(crate) const FRACTION_BITS: u32 = 2;

/// What is added to a code of `v` above 0 for the upper bits of the f32.
pub(crate) const BASE: u32 = (37 << FRACTION_BITS) - 1;

/// Bits of an f32 below those that a code of `v` keeps.
pub(crate) const DROPPED: u32 = 23 - FRACTION_BITS;

/// The code of the largest `v`.
pub(crate) const LARGEST_SECOND: u32 = (1 << SECOND_BITS) - 1;

/// The largest level of `m`.
pub(crate) const LARGEST_LEVEL: u32 = (1 << (CODE_BITS - SECOND_BITS - 1)) - 1;

/// Number of words for the moments of a row of `width` numbers.
pub fn words_per_row(width: usize) -> usize {
    width.div_ceil(CODES_PER_WORD as usize)
}

/// The scalars of a step with packed moments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackedFactors {
    /// The scalars of the step in f32.
    pub factors: Factors,
    /// Number of the step, from which the thresholds of rounding follow.
    pub step: u32,
}

impl PackedFactors {
    /// Largest `|m| / √v` that a level stands for. The stored `v` may be smaller than the true one by the distance of two codes.
    pub(crate) fn reach(&self) -> f64 {
        let Factors { beta1, beta2, .. } = self.factors;
        // At least a ten-thousandth: with β₁² ≥ β₂ there is no bound, and levels end at 100.
        let share = (1.0 - beta1 * beta1 / beta2).max(1e-4);
        ((1.0 + 0.5_f64.powi(FRACTION_BITS as i32)) / share).sqrt()
    }

    /// What the step adds to the thresholds: the step times the golden ratio, modulo 1, in units of 2⁻³².
    pub(crate) fn phase(&self) -> u32 {
        self.step.wrapping_mul(0x9e37_79b9)
    }
}

/// A parameter and its packed moments.
#[derive(Clone, Debug)]
pub struct PackedStep<const D: usize> {
    /// The parameter, `[N, …]`, f32.
    pub param: Tensor<D>,
    /// The moments, `[N, words_per_row]`, i32.
    pub words: Tensor<2, Int>,
}

/// Performs one step of Adam on `from`; all tensors are without autodiff. If a step is entered in `verdict`, nothing changes.
/// Pass `from` by its only handle: memory that nothing else holds is reused.
///
/// # Panics
/// If [`super::has_kernel`] is false; use [`step_on_host`] there. If the gradient or the moments do not fit the parameter.
pub fn step_packed<const D: usize>(
    from: PackedStep<D>,
    grad: &Tensor<D>,
    verdict: Option<&Tensor<1, Int>>,
    factors: PackedFactors,
) -> PackedStep<D> {
    let inputs = [from.param.into(), grad.into(), from.words.into(), verdict.into()];
    let mut found = apply(operation::AdamPacked(factors), inputs);
    PackedStep { param: found.float(0), words: found.int(1) }
}
