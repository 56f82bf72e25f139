//! Adam's step in one pass over memory, on GPUs, and the verdict that makes it skip.
//!
//! Elsewhere the optimiser is tensor code. On a GPU that code takes several passes per parameter, and choosing between the old
//! and new values of parameters and moments adds more. Here a unit reads each number once and writes it once, in place.
//!
//! With `g` the gradient clamped to ± `largest` (NaN is passed on), one step is
//!
//! `m ← β₁ m + g`, `v ← β₂ v + g²`, `θ ← θ − rate · m / (√v + floor)`:
//!
//! Kingma and Ba 2015, algorithm 1, with `m` and `v` divided by `1 − β₁` and `1 − β₂`. `rate` and `floor` include the bias
//! corrections and the learning rate. The rate may differ between index 0 of a parameter's second dimension and all other indices
//! ([`Rates`]), so that all coefficients of the spherical harmonics are one parameter.
//!
//! A **verdict** is two numbers, `[2]`: the first step at which a value was not finite (0: none), and the watched tensors in
//! which it was found, one bit each. [`watch`] enters its result unless an earlier step is entered; [`step`] changes nothing if
//! a step is entered. The verdict stays on the device, so that the host never waits for it.
//!
//! Shapes: parameter, gradient and moments share one shape, of any rank; f32.

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

/// A parameter and its moments.
#[derive(Clone, Debug)]
pub struct Stepped<const D: usize> {
    /// The parameter.
    pub param: Tensor<D>,
    /// First moment, `Σ β₁ᵏ g`.
    pub m: Tensor<D>,
    /// Second moment, `Σ β₂ᵏ g²`.
    pub v: Tensor<D>,
}

/// Performs one step of Adam on `from`; all tensors are without autodiff. If a step is entered in `verdict`, nothing changes.
/// Pass `from` by its only handle: memory that nothing else holds is reused.
///
/// # Errors
/// Returns `from` on devices without this operation; use tensor code there.
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

/// Returns `verdict` after a check of `values`, f32 or f64. If a value is not finite, `at_step` (from 1) is entered with bit
/// `bit`, unless an earlier step is entered.
///
/// # Errors
/// Returns `verdict` on devices without this operation; use tensor code there.
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

/// Whether the operations support this tensor.
#[cfg(feature = "cube")]
fn taken<const D: usize>(tensor: &Tensor<D>) -> bool {
    use burn::backend::DispatchDevice;
    matches!(tensor.device().as_dispatch(), DispatchDevice::Cube(_)) && tensor.dtype() == burn::tensor::DType::F32
}
