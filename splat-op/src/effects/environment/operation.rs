//! The composition over an environment as an operation.

use super::Sky;
use super::cpu::{environment_backward_cpu, environment_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_alpha_backward, launch_coefficients_backward, launch_environment};
use crate::backend::*;

/// The render over the environment, `[3, H, W]`.
#[derive(Clone, Debug)]
pub(super) struct OverEnvironment;

impl Operation for OverEnvironment {
    const DIFFERENTIABLE: &'static [usize] = &[0, 1, 3];

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([environment_cpu(Sky::from_array(slices(&args.all::<F, 4>())))])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_environment(&args.gpu(), &Sky::from_array(args.all()))])
    }

    // The gradient of the picture is that of the composition.
    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, needs) = (args.all::<F, 4>(), Sky::from_array(args.needs()));
        let grads = environment_backward_cpu(Sky::from_array(slices(&read)), &args.only_grad(), needs);
        vec![
            HostOutput::Grad(0),
            HostOutput::floats(grads.alpha),
            HostOutput::Nothing,
            HostOutput::floats(grads.coefficients),
        ]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, inputs, grad) = (args.gpu(), Sky::from_array(args.all()), args.only_grad());
        let needs: Sky<bool> = Sky::from_array(args.needs());
        let alpha = needs.alpha.then(|| launch_alpha_backward(&gpu, &inputs, &grad).handle);
        let coefficients = needs.coefficients.then(|| launch_coefficients_backward(&gpu, &inputs, &grad).handle);
        vec![Some(grad.handle), alpha, None, coefficients]
    }
}
