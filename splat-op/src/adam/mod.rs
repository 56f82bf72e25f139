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
pub(crate) mod launch;
pub(crate) mod rule;

#[cfg(feature = "cube")]
use burn::backend::Dispatch;
use burn::tensor::{Int, Tensor};
pub use rule::{Band, Factors, Rates, VERDICT};

#[cfg(feature = "cube")]
use crate::backend::adam::{AdamBackend, AdamInputs, AdamState, Held};

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
        let inputs = AdamInputs {
            param: from.param.into_dispatch(),
            grad: grad.clone().into_dispatch(),
            m: from.m.into_dispatch(),
            v: from.v.into_dispatch(),
            held: verdict.map_or(Held::Never, |verdict| Held::By(verdict.clone().into_dispatch())),
        };
        let AdamState { param, m, v } = <Dispatch as AdamBackend>::adam(inputs, factors);
        let [param, m, v] = [param, m, v].map(Tensor::from_dispatch);
        return Ok(Stepped { param, m, v });
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
        let (values, verdict) = (values.clone().into_dispatch(), verdict.into_dispatch());
        return Ok(Tensor::from_dispatch(<Dispatch as AdamBackend>::watch(values, verdict, at_step, bit)));
    }
    Err(verdict)
}

/// Whether the operations take this tensor.
#[cfg(feature = "cube")]
fn taken<const D: usize>(tensor: &Tensor<D>) -> bool {
    use burn::backend::DispatchDevice;
    matches!(tensor.device().as_dispatch(), DispatchDevice::Cube(_)) && tensor.dtype() == burn::tensor::DType::F32
}
