//! The projection as an operation.

use super::cpu::{project_backward_cpu, project_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_project, launch_project_backward};
use super::{COLUMNS, Geometry, ProjectSpec};
use crate::backend::*;

/// Packed ellipses, `[N, 7]`.
#[derive(Clone, Debug)]
pub(crate) struct Project(pub ProjectSpec);

impl Operation for Project {
    const DIFFERENTIABLE: &'static [usize] = &[0, 1, 2, 3, 4, 5];

    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[0].as_ref().map(|means| means.with_shape([means.shape[0], COLUMNS]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([project_cpu(Geometry::from_array(slices(&args.all::<F, 6>())), &self.0)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_project(&args.gpu(), &Geometry::from_array(args.all()), &self.0)])
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, needs) = (args.all::<F, 6>(), Geometry::from_array(args.needs()));
        let inputs = Geometry::from_array(slices(&read));
        float_outputs(project_backward_cpu(inputs, &args.only_grad(), &self.0, needs).into_array())
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (inputs, needs) = (Geometry::from_array(args.all()), Geometry::from_array(args.needs()));
        gpu_outputs(launch_project_backward(&args.gpu(), &inputs, &args.only_grad(), &self.0, needs).into_array())
    }
}
