//! A value whose derivative is already known.

use burn::tensor::Tensor;
use burn::tensor::kind::Autodiff;

use super::*;

/// Takes a variable, a value, `[1]`, and the derivative of the value with respect to the variable; returns the value.
#[derive(Clone, Debug)]
struct WithGradient;

impl Operation for WithGradient {
    const DIFFERENTIABLE: &'static [usize] = &[0];

    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[1].clone()]
    }

    fn run<F: Real>(&self, _: &HostArgs) -> Vec<HostOutput> {
        vec![HostOutput::Input(1)]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        vec![Some(args.handle(1))]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        vec![HostOutput::Scaled(2, args.only_grad::<F>()[0].f64()), HostOutput::Nothing, HostOutput::Nothing]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        use crate::backend::cube::{buffer, owned};

        let (gpu, factor) = (args.gpu(), args.only_grad());
        let gradient = buffer(owned(args.take(2)));
        crate::gpu::launch_scale(&gpu, &gradient, &factor);
        vec![Some(gradient.handle), None, None]
    }
}

/// Returns `value`, `[1]`, with `gradient` as its derivative with respect to `variable`. `gradient` has the shape of `variable`.
/// For losses whose derivative is cheaper in closed form than as a graph of small operations. `value` and `gradient` are
/// constants. All are f32, or f64 on CPUs.
///
/// # Panics
/// If the shapes of `variable` and `gradient` differ.
pub fn with_gradient<const D: usize>(variable: Tensor<D>, value: Tensor<1>, gradient: Tensor<D>) -> Tensor<1> {
    assert_eq!(variable.dims(), gradient.dims(), "a derivative has the shape of its variable");
    apply(WithGradient, [variable.into(), value.into(), gradient.into()]).float(0)
}

/// Returns values as constants beside tensors of a device with autodiff, if `beside_tracked` is set, or of one without.
pub(crate) fn constant<const D: usize, K: Autodiff>(values: &Tensor<D, K>, beside_tracked: bool) -> Tensor<D, K> {
    if beside_tracked { values.clone().autodiff() } else { values.clone() }
}

/// Returns the values of a tensor, on a device without autodiff.
pub(crate) fn plain<const D: usize>(tensor: &Tensor<D>) -> Tensor<D> {
    if tensor.is_autodiff() { tensor.clone().inner() } else { tensor.clone() }
}
