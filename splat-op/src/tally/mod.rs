//! Running sums of gradient norms, one per Gaussian, in one pass over memory, on GPUs. Density control reads them now and then
//! (Kerbl et al. 2023, section 5.2). Elsewhere they are tensor code, which takes seven passes.
//!
//! With `g` the gradient at a projected centre and `s` the units per axis, one step is
//!
//! `sum ← sum + |g s|`, `count ← count + 1` where `|g s| > 0`. NaN counts as no gradient and is added to the sum.
//!
//! Shapes: gradients `[N, 2]`, sums and counts `[N]`; f32.

#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(feature = "cube")]
mod operation;

use burn::tensor::Tensor;

/// Sums of gradient norms and numbers of steps with a gradient, `[N]` each.
#[derive(Clone, Debug)]
pub struct Tally {
    /// Sums of norms.
    pub sums: Tensor<1>,
    /// Numbers of steps with a gradient.
    pub counts: Tensor<1>,
}

/// Returns the tally after one more step, or after the first if there is none. `grad`, `[N, 2]`, is without autodiff, and is scaled by
/// `per_axis`. Memory of the tally that nothing else holds is reused.
///
/// # Errors
/// Returns the tally on devices without this operation; use tensor code there.
#[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "no GPU runtime is compiled in"))]
#[expect(clippy::result_large_err, reason = "the error is the argument, handed back")]
pub fn add(tally: Option<Tally>, grad: &Tensor<2>, per_axis: [f32; 2]) -> Result<Tally, Option<Tally>> {
    #[cfg(feature = "cube")]
    {
        use burn::backend::DispatchDevice;
        use burn::tensor::DType;

        use crate::backend::apply;

        let on_gpu = matches!(grad.device().as_dispatch(), DispatchDevice::Cube(_)) && grad.dtype() == DType::F32;
        if on_gpu {
            let (sums, counts) = tally.map(|tally| (tally.sums, tally.counts)).unzip();
            let mut found = apply(operation::AddToTally { per_axis }, [grad.into(), sums.into(), counts.into()]);
            return Ok(Tally { sums: found.float(0), counts: found.float(1) });
        }
    }
    Err(tally)
}
