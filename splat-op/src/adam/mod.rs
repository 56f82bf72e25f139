//! Adam's step in one pass over memory, on GPUs, and the verdict that holds it back.
//!
//! The optimiser is tensor code like any other, and elsewhere it stays that. On a GPU that code is a handful of passes per
//! parameter, and choosing between the old and the new values of parameters and moments makes it several more; here a unit
//! reads each number once and writes it once, in place.
//!
//! With `g` the gradient held within ± `largest` (NaN is passed on), one step is
//!
//! `m ← β₁ m + g`, `v ← β₂ v + g²`, `θ ← θ − rate · m / (√v + floor)`:
//!
//! Kingma and Ba 2015, algorithm 1, with `m` and `v` divided by `1 − β₁` and `1 − β₂`, and bias corrections and learning rate
//! gathered in `rate` and `floor`. The rate may differ between the first row of a parameter's second dimension and the others
//! ([`Rates`]), so that all coefficients of the spherical harmonics are one parameter.
//!
//! A **verdict** is two numbers, `[2]`: the first step at which something was not finite (0: none), and which of the watched
//! tensors it was, a bit each. [`watch`] enters what it finds unless an earlier step is entered already; [`step`] changes
//! nothing where a step is entered. Both stay on the device, so that nobody waits for it.
//!
//! Shapes: parameter, gradient and moments have one shape, any; f32.

#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod launch;
#[cfg(feature = "cube")]
mod op;

use burn::tensor::{Int, Tensor};

#[cfg(feature = "cube")]
pub use op::{AdamBackend, AdamInputs, AdamState, Held};

/// Numbers of a verdict.
pub const VERDICT: usize = 2;

/// The rates of a parameter `[N, K, …]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Of what has index 0 in the second dimension.
    pub first: f64,
    /// Of all else, and of parameters of one dimension.
    pub others: f64,
}

impl From<f64> for Rates {
    /// One rate for all.
    fn from(rate: f64) -> Self {
        Self { first: rate, others: rate }
    }
}

impl Rates {
    /// Both times `factor`.
    pub fn times(self, factor: f64) -> Self {
        Self { first: self.first * factor, others: self.others * factor }
    }

    /// Where the first rate holds in a parameter of the shape `dims`: what has index 0 in its second dimension. `None` if
    /// there is one rate for all.
    pub fn band(&self, dims: &[usize]) -> Option<Band> {
        let width = dims.get(2..).unwrap_or_default().iter().product::<usize>();
        let period = dims.get(1).map_or(0, |rows| rows * width);
        (self.first != self.others && period > 0).then_some(Band { period, width })
    }
}

/// The first `width` of every `period` numbers, row-major. Neither is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Band {
    /// Numbers from one band to the next.
    pub period: usize,
    /// Numbers of one band.
    pub width: usize,
}

/// The scalars of one step; see [this module](self).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factors {
    /// Share of the first moment that is kept.
    pub beta1: f64,
    /// Share of the second moment that is kept.
    pub beta2: f64,
    /// The learning rates with both bias corrections.
    pub rate: Rates,
    /// Added to the root of the second moment, above 0.
    pub floor: f64,
    /// The largest absolute value of a gradient that is computed with.
    pub largest: f64,
}

/// A parameter with its moments.
#[derive(Clone, Debug)]
pub struct Stepped<const D: usize> {
    /// The parameter.
    pub param: Tensor<D>,
    /// `Σ β₁ᵏ g`
    pub m: Tensor<D>,
    /// `Σ β₂ᵏ g²`
    pub v: Tensor<D>,
}

/// One step of Adam on `from`, all without autodiff. With `verdict`, nothing changes where a step is entered in it. Memory is
/// reused where nobody else holds it: hand `from` over.
///
/// # Errors
/// Gives `from` back on devices that have no such operation: compute it with tensor code there.
#[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "no GPU runtime is compiled in"))]
#[expect(clippy::result_large_err, reason = "the error is the argument, handed back")]
pub fn step<const D: usize>(
    from: Stepped<D>,
    grad: &Tensor<D>,
    verdict: Option<&Tensor<1, Int>>,
    factors: Factors,
) -> Result<Stepped<D>, Stepped<D>> {
    #[cfg(feature = "cube")]
    if taken(&from.param) {
        return Ok(op::step(from, grad, verdict, factors));
    }
    Err(from)
}

/// `verdict` after a look at `values`, which are f32 or f64: if one is not finite, `at_step` (from 1) is entered with bit
/// `bit`, unless an earlier step is entered.
///
/// # Errors
/// Gives `verdict` back on devices that have no such operation: compute it with tensor code there.
#[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "no GPU runtime is compiled in"))]
#[expect(clippy::result_large_err, reason = "the error is the argument, handed back")]
pub fn watch<const D: usize>(
    values: &Tensor<D>,
    verdict: Tensor<1, Int>,
    at_step: u32,
    bit: u32,
) -> Result<Tensor<1, Int>, Tensor<1, Int>> {
    #[cfg(feature = "cube")]
    if taken(values) {
        return Ok(op::watch(values, verdict, at_step, bit));
    }
    Err(verdict)
}

/// Whether the operations take this tensor.
#[cfg(feature = "cube")]
fn taken<const D: usize>(tensor: &Tensor<D>) -> bool {
    use burn::backend::DispatchDevice;
    matches!(tensor.device().as_dispatch(), DispatchDevice::Cube(_)) && tensor.dtype() == burn::tensor::DType::F32
}
