//! Adam's step with moments of 16 or 8 bits instead of 32: an approximation of [the step in f32](super).
//!
//! A step decodes the moments of a number, computes the step in f32, and encodes the new moments. One code holds both:
//!
//! - `v` as a float without a sign: its exponent and the first bits of its fraction. Zero is the code 0.
//! - `m` as a sign and a level `q`: `m = ± (q / Q)² · reach · √v`, with `Q` the largest level and `v` as it is stored. By Cauchy and
//!   Schwarz `|m| ≤ √v / √(1 − β₁² / β₂)`, so that every `m` has a level. `√v · (q / Q)²` is what a step is proportional to, so an error
//!   of `m` is an error of the step and never more than a share of the learning rate. The levels lie closer near zero, where most are.
//!
//! | bits of a moment | bits of a code | exponent and fraction of `v` | smallest `v` above 0 | sign and level of `m` |
//! |---|---|---|---|---|
//! | 16 | 32 | 8 + 8 | 2⁻¹²⁶ | 1 + 15 |
//! | 8 | 16 | 7 + 2 | 2⁻⁹⁰ | 1 + 6 |
//!
//! In a step `v` loses a thousandth, less than the distance of two codes: rounding to the nearest code would hold it where it is. Both
//! moments are therefore rounded up or down in proportion to their distances (Gupta et al. 2015, "Deep Learning with Limited Numerical
//! Precision", section 3.1). The threshold is not drawn but computed from the index of the number and the step's:
//! `hash(index) + step · φ` modulo 1, so that a run repeats bit for bit. The steps of a number take thresholds that are spread evenly.
//! With gradients of noise, the error of a step is then a sixth of it with 8 bits and 0.7% with 16, where thresholds drawn independently
//! give a fifth and 1%. The price is that a rounding depends on the one before: without gradients, `v` falls in 1,000 steps to 0.33 of
//! what it was with 8 bits, where f32 has 0.37.
//!
//! Codes are in words of 32 bits, row by row of the parameter: word `j` of a row holds the codes `j` (16 bits) or `2j`, in its lower half,
//! and `2j + 1` (8 bits). Codes beyond the end of a row are 0. A row of zeros has no history. Rows may be moved and appended, and a row
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

/// How moments are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Packing {
    /// 16 bits for each moment.
    Sixteen,
    /// 8 bits for each moment.
    Eight,
}

impl Packing {
    /// Number of words for the moments of a row of `width` numbers.
    pub fn words_per_row(self, width: usize) -> usize {
        width.div_ceil(self.form().codes_per_word() as usize)
    }

    pub(crate) const fn form(self) -> Form {
        match self {
            Self::Sixteen => Form { code: 32, second: 16, fraction: 8, base: 0 },
            Self::Eight => Form { code: 16, second: 9, fraction: 2, base: (37 << 2) - 1 },
        }
    }
}

/// The bits of a code: `v` in the lower ones, then the level of `m`, then its sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Form {
    /// Number of bits of a code.
    pub code: u32,
    /// Number of bits of `v`.
    pub second: u32,
    /// Number of bits of the fraction of `v`.
    pub fraction: u32,
    /// What is added to a code of `v` above 0 for the upper bits of the f32.
    pub base: u32,
}

impl Form {
    pub const fn codes_per_word(self) -> u32 {
        32 / self.code
    }

    /// Bits of an f32 below those that a code of `v` keeps.
    pub const fn dropped(self) -> u32 {
        23 - self.fraction
    }

    /// The code of the largest `v`, which is finite.
    pub const fn largest_second(self) -> u32 {
        let (room, finite) = ((1 << self.second) - 1, (0xff << self.fraction) - 1 - self.base);
        if room < finite { room } else { finite }
    }

    /// The largest level of `m`.
    pub const fn largest_level(self) -> u32 {
        (1 << (self.code - self.second - 1)) - 1
    }
}

/// The scalars of a step with packed moments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PackedFactors {
    /// The scalars of the step in f32.
    pub factors: Factors,
    /// How the moments are packed.
    pub packing: Packing,
    /// Number of the step, from which the thresholds of rounding follow.
    pub step: u32,
}

impl PackedFactors {
    /// Largest `|m| / √v` that a level stands for. The stored `v` may be smaller than the true one by the distance of two codes.
    pub(crate) fn reach(&self) -> f64 {
        let Factors { beta1, beta2, .. } = self.factors;
        // At least a ten-thousandth: with β₁² ≥ β₂ there is no bound, and levels end at 100.
        let share = (1.0 - beta1 * beta1 / beta2).max(1e-4);
        ((1.0 + 0.5_f64.powi(self.packing.form().fraction as i32)) / share).sqrt()
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
