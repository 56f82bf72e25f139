//! Gaussians in ray space, and their bounds, as operations.

use super::cpu::{ray_space_backward_cpu, ray_space_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_bounds, launch_ray_space, launch_ray_space_backward};
use super::{bounds_cpu, columns};
use crate::backend::*;
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::RasterizeSpec;

/// The Gaussians in ray space, `[N, 9]`, with a lens `[N, 15]`.
#[derive(Clone, Debug)]
pub(crate) struct RaySpace(pub ProjectSpec);

impl Operation for RaySpace {
    // All but the opacities.
    const DIFFERENTIABLE: &'static [usize] = &[0, 1, 2, 4, 5];

    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let columns = columns(&self.0.intrinsics);
        vec![inputs[0].as_ref().map(|means| means.with_shape([means.shape[0], columns]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([ray_space_cpu(Geometry::from_array(slices(&args.all::<F, 6>())), &self.0)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_ray_space(&args.gpu(), &Geometry::from_array(args.all()), &self.0)])
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, needs) = (args.all::<F, 6>(), Geometry::from_array(args.needs()));
        let inputs = Geometry::from_array(slices(&read));
        float_outputs(ray_space_backward_cpu(inputs, &args.only_grad(), &self.0, needs).into_array())
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (inputs, needs) = (Geometry::from_array(args.all()), Geometry::from_array(args.needs()));
        gpu_outputs(launch_ray_space_backward(&args.gpu(), &inputs, &args.only_grad(), &self.0, needs).into_array())
    }
}

/// Bounds as rows `[N, 7]` for the intersection, from packed ellipses `[N, 7]` and their rows in ray space. Not differentiable.
#[derive(Clone, Debug)]
pub(crate) struct BoundRows(pub RasterizeSpec);

impl Operation for BoundRows {
    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([bounds_cpu::<F>(&args.floats(0), &args.floats(1), &self.0)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_bounds(&args.gpu(), &args.buffer(0), &args.buffer(1), &self.0)])
    }
}
