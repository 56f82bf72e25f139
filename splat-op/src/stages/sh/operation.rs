//! The evaluation of spherical harmonics as an operation.

use super::Shading;
use super::cpu::{ShCpuInputs, Visible, sh_backward_cpu, sh_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_sh, launch_sh_backward};
use crate::backend::*;
use crate::project::ProjectSpec;

/// Colours, `[N, 3]`. Takes the tensors of [`Shading`] and, optionally, packed ellipses: only Gaussians that are visible in the picture of
/// the specification then get colours. The set of visible Gaussians is piecewise constant, so the ellipses have no gradient.
#[derive(Clone, Debug)]
pub(crate) struct EvaluateSh(pub ProjectSpec);

impl EvaluateSh {
    /// Calls `f` with the inputs of the twin.
    fn with<F: Real, T>(&self, args: &HostArgs, f: impl FnOnce(ShCpuInputs<F>, Option<&Visible<F>>) -> T) -> T {
        let (read, ellipses) = (args.all::<F, 3>(), args.has(3).then(|| args.floats::<F>(3)));
        let [sh, means, cam_from_world] = slices(&read);
        let inputs = ShCpuInputs { sh, means, cam_from_world, coefficients: args.shape(0)[1] };
        f(inputs, ellipses.as_deref().map(|ellipses| Visible::new(ellipses, &self.0)).as_ref())
    }
}

impl Operation for EvaluateSh {
    const DIFFERENTIABLE: &'static [usize] = &[0, 1, 2];

    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[1].clone()]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([self.with::<F, _>(args, sh_cpu)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let visible = args.optional(3);
        let visible = visible.as_ref().map(|ellipses| (ellipses, &self.0));
        gpu_outputs([launch_sh(&args.gpu(), &Shading::from_array(args.all()), visible, args.shape(0)[1])])
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (grad, needs) = (args.only_grad::<F>(), Shading::from_array(args.needs()));
        let grads = self.with(args, |inputs, visible| sh_backward_cpu(inputs, visible, &grad, needs));
        float_outputs(grads.into_array()).into_iter().chain([HostOutput::Nothing]).collect()
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (visible, needs) = (args.optional(3), Shading::from_array(args.needs()));
        let visible = visible.as_ref().map(|ellipses| (ellipses, &self.0));
        let (inputs, coefficients) = (Shading::from_array(args.all()), args.shape(0)[1]);
        let grads = launch_sh_backward(&args.gpu(), &inputs, visible, coefficients, &args.only_grad(), needs);
        gpu_outputs(grads.into_array()).into_iter().chain([None]).collect()
    }
}
