//! The evaluation of spherical harmonics as an operation.

use super::Shading;
use super::cpu::{ShCpuInputs, Visible, sh_backward_cpu, sh_cpu};
#[cfg(feature = "cube")]
use super::launch::{ShDeviceInputs, launch_sh, launch_sh_backward};
#[cfg(feature = "cube")]
use crate::backend::cube::{gpu_outputs, optional_outputs};
use crate::backend::host::{Host, float_outputs};
use crate::backend::*;
use crate::project::ProjectSpec;

/// Colours, `[N, 3]`. Takes the tensors of [`Shading`] and, optionally, packed ellipses: only Gaussians that are visible in the picture of
/// the specification then get colours. The set of visible Gaussians is piecewise constant, so the ellipses have no gradient.
#[derive(Clone, Debug)]
pub(crate) struct EvaluateSh(pub ProjectSpec);

struct Read<F: Real> {
    sh: Host<F>,
    means: Host<F>,
    cam_from_world: Host<F>,
    ellipses: Option<Host<F>>,
    coefficients: usize,
}

impl<F: Real> Read<F> {
    fn new(args: &HostArgs) -> Self {
        Self {
            sh: args.floats(0),
            means: args.floats(1),
            cam_from_world: args.floats(2),
            ellipses: args.has(3).then(|| args.floats(3)),
            coefficients: args.shape(0)[1],
        }
    }

    fn inputs(&self) -> ShCpuInputs<'_, F> {
        let Self { sh, means, cam_from_world, coefficients, .. } = self;
        ShCpuInputs { sh, means, cam_from_world, coefficients: *coefficients }
    }

    fn visible(&self, spec: &ProjectSpec) -> Option<Visible<'_, F>> {
        self.ellipses.as_deref().map(|ellipses| Visible::new(ellipses, spec))
    }
}

#[cfg(feature = "cube")]
fn read(args: &GpuArgs) -> ShDeviceInputs {
    ShDeviceInputs { sh: args.buffer(0), means: args.buffer(1), cam_from_world: args.buffer(2) }
}

impl Operation for EvaluateSh {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[1].clone()]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = Read::<F>::new(args);
        float_outputs([sh_cpu(read.inputs(), read.visible(&self.0).as_ref())])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let visible = args.optional(3);
        let visible = visible.as_ref().map(|ellipses| (ellipses, &self.0));
        gpu_outputs([launch_sh(&args.gpu(), &read(&args), visible, args.shape(0)[1])])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0, 1, 2]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, needs) = (Read::<F>::new(args), Shading::from_array(args.needs()));
        let grads = sh_backward_cpu(read.inputs(), read.visible(&self.0).as_ref(), &args.only_grad(), needs);
        float_outputs(grads.into_array()).into_iter().chain([HostOutput::Nothing]).collect()
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (visible, needs) = (args.optional(3), Shading::from_array(args.needs()));
        let visible = visible.as_ref().map(|ellipses| (ellipses, &self.0));
        let coefficients = args.shape(0)[1];
        let grads = launch_sh_backward(&args.gpu(), &read(&args), visible, coefficients, &args.only_grad(), needs);
        optional_outputs(grads.into_array()).into_iter().chain([None]).collect()
    }
}
