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
pub use rule::{Band, Factors, Rates, VERDICT};

use crate::abilities::is_gpu;
use crate::activate::RawSplats;
pub use crate::activate::rule::Raw;
use crate::backend::{Slot, apply, apply_all};

/// Whether there is a kernel for a parameter or a loss: in f32, on a GPU.
pub fn has_kernel<const D: usize>(tensor: &Tensor<D>) -> bool {
    is_gpu(&tensor.device()) && tensor.dtype() == DType::F32
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
/// If [`has_kernel`] is false; use tensor code there.
pub fn step<const D: usize>(
    from: Stepped<D>,
    grad: &Tensor<D>,
    verdict: Option<&Tensor<1, Int>>,
    factors: Factors,
) -> Stepped<D> {
    let inputs = [from.param.into(), grad.into(), from.m.into(), from.v.into(), verdict.into()];
    let mut found = apply(operation::Adam(factors), inputs);
    Stepped { param: found.float(0), m: found.float(1), v: found.float(2) }
}

/// The parameters of a scene with their moments and their gradients, each set as in [`RawSplats`].
#[derive(Clone, Debug)]
pub struct SceneStep {
    /// The parameters.
    pub params: RawSplats,
    /// Their gradients.
    pub grads: RawSplats,
    /// First moments, `Σ β₁ᵏ g`.
    pub m: RawSplats,
    /// Second moments, `Σ β₂ᵏ g²`.
    pub v: RawSplats,
}

/// The parameters of a scene and their moments after a step.
#[derive(Clone, Debug)]
pub struct SteppedScene {
    /// The parameters.
    pub params: RawSplats,
    /// First moments, `Σ β₁ᵏ g`.
    pub m: RawSplats,
    /// Second moments, `Σ β₂ᵏ g²`.
    pub v: RawSplats,
    /// `[1]`: zero if all colour coefficients are usable, for [`crate::activate::activated`].
    pub mark: Tensor<1, Int>,
}

/// Performs [`step`] for all parameters of a scene in two launches. `mark`, `[1]`, is a zero before the first step and comes from the
/// step before afterwards; it is set once a coefficient is not usable.
///
/// Shapes and ownership as in [`step`].
///
/// # Panics
/// If [`has_kernel`] is false.
pub fn step_scene(
    from: SceneStep,
    verdict: Option<&Tensor<1, Int>>,
    mark: Tensor<1, Int>,
    factors: Raw<Factors>,
) -> SteppedScene {
    let SceneStep { params, grads, m, v } = from;
    let [params, grads, m, v] = [params, grads, m, v].map(slots);
    let of_params = params.zip(grads).zip(m.zip(v)).into_array();
    let mut inputs: Vec<_> = of_params.into_iter().flat_map(|((param, grad), (m, v))| [param, grad, m, v]).collect();
    inputs.extend([mark.into(), verdict.into()]);
    let mut found = apply_all(operation::AdamScene(factors), inputs);
    let mut splats = |of: usize| RawSplats {
        means: found.float(of),
        rotations: found.float(3 + of),
        log_scales: found.float(6 + of),
        logit_opacities: found.float(9 + of),
        sh: found.float(12 + of),
    };
    let [params, m, v] = [0, 1, 2].map(&mut splats);
    SteppedScene { params, m, v, mark: found.int(15) }
}

/// The gradients of a scene's parameters that [`watch`] looks at.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneGradients<'a> {
    /// `[N, 3]`.
    pub means: Option<&'a Tensor<2>>,
    /// `[N, 4]`.
    pub rotations: Option<&'a Tensor<2>>,
    /// `[N, 3]`.
    pub log_scales: Option<&'a Tensor<2>>,
    /// `[N]`.
    pub logit_opacities: Option<&'a Tensor<1>>,
    /// `[N, K, 3]`.
    pub sh: Option<&'a Tensor<3>>,
}

/// Returns `verdict` after a check of a loss and the gradients of a scene, in one launch. If a value is not finite, `at_step` (from 1) is
/// entered, unless an earlier step is entered, with bit 0 for the loss and bits 1 to 5 for the gradients in the order of their fields.
///
/// # Panics
/// If [`has_kernel`] is false; use tensor code there.
pub fn watch(loss: &Tensor<1>, gradients: SceneGradients, verdict: Tensor<1, Int>, at_step: u32) -> Tensor<1, Int> {
    let SceneGradients { means, rotations, log_scales, logit_opacities, sh } = gradients;
    let inputs = [
        loss.into(),
        verdict.into(),
        means.into(),
        rotations.into(),
        log_scales.into(),
        logit_opacities.into(),
        sh.into(),
    ];
    apply(operation::Watch { at_step }, inputs).int(0)
}

fn slots(tensors: RawSplats) -> Raw<Slot<Dispatch>> {
    let RawSplats { means, rotations, log_scales, logit_opacities, sh } = tensors;
    Raw {
        means: means.into(),
        rotations: rotations.into(),
        log_scales: log_scales.into(),
        logit_opacities: logit_opacities.into(),
        sh: sh.into(),
    }
}
