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
//! corrections and the learning rate. The first numbers of each row may have another rate than the others ([`Rates`]), so that all
//! coefficients of the spherical harmonics are one parameter.
//!
//! A **verdict** is two numbers, `[2]`: the first step at which a value was not finite (0: none), and the watched tensors in
//! which it was found, one bit each. [`watch`] enters its result unless an earlier step is entered; [`step`] changes nothing if
//! a step is entered. The verdict stays on the device, so that the host never waits for it.
//!
//! A **mark** is one number, `[1]`, zero as long as every colour coefficient that a step of a scene has written is usable (see
//! [`crate::activate`]). The next activation then need not read the coefficients, most of a scene's data, to find that out.
//!
//! [`packed`] is the same step with moments of fewer bits.
//!
//! Shapes: parameter, gradient and moments share one shape, of any rank; f32.

#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
pub mod packed;
pub(crate) mod rule;

use burn::backend::Dispatch;
use burn::tensor::{DType, Int, Tensor};
pub use rule::{Band, Factors, LAST_BIT, Rates, VERDICT};

use crate::backend::{Slot, apply_all};
use crate::{is_gpu, is_tensor_code};

/// Whether there is a kernel for a parameter or a loss: in f32, on a GPU, and not in [tensor code](crate::in_tensor_code).
pub fn has_kernel<const D: usize>(tensor: &Tensor<D>) -> bool {
    is_gpu(&tensor.device()) && tensor.dtype() == DType::F32 && !is_tensor_code()
}

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
/// # Panics
/// If [`has_kernel`] is false; use tensor code there. If the gradient or a moment has another shape than the parameter.
pub fn step<const D: usize>(
    from: Stepped<D>,
    grad: &Tensor<D>,
    verdict: Option<&Tensor<1, Int>>,
    factors: Factors,
) -> Stepped<D> {
    let step = [from.param.into(), grad.into(), from.m.into(), from.v.into()];
    let inputs = [verdict.into(), Slot::Absent].into_iter().chain(step).collect();
    let mut found = apply_all(operation::AdamGroups { factors: vec![factors], marked: None }, inputs);
    Stepped { param: found.float(1), m: found.float(2), v: found.float(3) }
}

/// A parameter of a scene with its gradient.
#[derive(Clone, Debug)]
pub struct GroupStep {
    /// `[n, width]`: the parameter and its moments.
    pub from: Stepped<2>,
    /// `[n, width]`: its gradient.
    pub grad: Tensor<2>,
    /// Scalars of its step.
    pub factors: Factors,
}

/// Performs [`step`] for all parameters of a scene, up to three in a launch, and returns them in the same order. Ownership as in [`step`].
///
/// `mark` is the place of the colour coefficients among the parameters, not the only one, and their mark, `[1]`: a zero before the
/// first step, later that of the step before. The mark returned is set once a coefficient is not usable, and serves
/// [`crate::activate::activated`].
///
/// # Panics
/// As [`step`].
pub fn step_groups(
    steps: Vec<GroupStep>,
    verdict: Option<&Tensor<1, Int>>,
    mark: Option<(usize, Tensor<1, Int>)>,
) -> (Vec<Stepped<2>>, Option<Tensor<1, Int>>) {
    let (marked, mark) = mark.filter(|_| steps.len() > 1).unzip();
    let (count, has_mark) = (steps.len(), mark.is_some());
    let factors = steps.iter().map(|step| step.factors).collect();
    let mut inputs: Vec<Slot<Dispatch>> = vec![verdict.into(), mark.into()];
    for GroupStep { from: Stepped { param, m, v }, grad, .. } in steps {
        inputs.extend([param.into(), grad.into(), m.into(), v.into()]);
    }
    let mut found = apply_all(operation::AdamGroups { factors, marked }, inputs);
    let mut stepped = |i| Stepped { param: found.float(i), m: found.float(i + 1), v: found.float(i + 2) };
    let steps = (0..count).map(|i| stepped(1 + 3 * i)).collect();
    (steps, has_mark.then(|| found.int(0)))
}

/// Returns `verdict` after a check of a loss and of gradients, five in a launch. If a value is not finite, `at_step` (from 1) is entered,
/// unless an earlier step is entered, with bit 0 for the loss and bit `i + 1` for gradient `i`; from [`LAST_BIT`] on they share it.
///
/// # Panics
/// If [`has_kernel`] is false; use tensor code there.
pub fn watch(
    loss: &Tensor<1>,
    gradients: &[Option<&Tensor<2>>],
    verdict: Tensor<1, Int>,
    at_step: u32,
) -> Tensor<1, Int> {
    let look = |verdict: Tensor<1, Int>, (launch, five): (usize, &[Option<&Tensor<2>>])| {
        let first = (launch * rule::WATCHED) as u32;
        let gradients = (0..rule::WATCHED).map(|i| five.get(i).copied().flatten().into());
        apply_all(
            operation::Watch { at_step, first },
            [loss.into(), verdict.into()].into_iter().chain(gradients).collect(),
        )
        .int(0)
    };
    // Once at least, for the loss.
    let rest = gradients.get(rule::WATCHED..).unwrap_or_default();
    let first = &gradients[..gradients.len() - rest.len()];
    std::iter::once(first).chain(rest.chunks(rule::WATCHED)).enumerate().fold(verdict, look)
}
