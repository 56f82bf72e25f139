//! The rasterizer along rays as an operation.

use super::RayLayers;
use super::cpu::{RayTrace, rasterize_rays_backward_cpu, rasterize_rays_cpu};
#[cfg(feature = "cube")]
use super::launch::{ROOM, launch_rasterize_rays, launch_rasterize_rays_backward};
#[cfg(feature = "cube")]
use crate::backend::cube::optional_outputs;
use crate::backend::host::{float_outputs, slices};
use crate::backend::*;
#[cfg(feature = "cube")]
use crate::gpu::{Buffer, Gpu};
use crate::intersect::operation::lists;
#[cfg(feature = "cube")]
use crate::intersect::{Cut, launch::DeviceIntersections, launch::launch_intersect};
use crate::intersect::{IntersectionCell, IntersectionLists};
#[cfg(feature = "cube")]
use crate::rasterize::operation::{grad_of_planes, split_planes};
use crate::rasterize::operation::{host_grads, keep, plane_slices, planes, split};
use crate::rasterize::{RasterizeSpec, TraceCell};
use crate::ray_space::bounds_cpu;
#[cfg(feature = "cube")]
use crate::ray_space::launch::launch_bounds;

/// Planes as those of [`Rasterize`](crate::rasterize::operation::Rasterize), from the tensors of [`RayLayers`] and the output of the
/// intersection. A GPU keeps no trace.
#[derive(Clone, Debug)]
pub(crate) struct RasterizeRays {
    pub spec: RasterizeSpec,
    pub lists: IntersectionCell,
    /// Filled for the backward pass, if there is one.
    pub trace: Option<TraceCell>,
}

impl RasterizeRays {
    fn host_lists(&self, inputs: &RayLayers<&[impl Real]>) -> &IntersectionLists {
        self.lists.on_host(|| lists(&bounds_cpu(inputs.projected, inputs.ray_space, &self.spec), &self.spec))
    }

    #[cfg(feature = "cube")]
    fn device_lists(&self, gpu: &Gpu, inputs: &RayLayers<Buffer<f32>>) -> &DeviceIntersections {
        let RasterizeSpec { intrinsics, options } = &self.spec;
        self.lists.on_device(|| {
            let bounds = launch_bounds(gpu, &inputs.projected, &inputs.ray_space, &self.spec);
            launch_intersect(gpu, &bounds, intrinsics, Cut::of(options))
        })
    }
}

impl Operation for RasterizeRays {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        planes(&self.spec, inputs[3].as_ref())
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = args.all::<F, 5>();
        let inputs = RayLayers::from_array(slices(&read));
        let (planes, kept) = rasterize_rays_cpu(inputs, &self.spec, self.host_lists(&inputs), self.trace.is_some());
        keep(self.trace.as_ref(), kept);
        split(planes, &self.spec)
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, inputs) = (args.gpu(), RayLayers::from_array(args.all()));
        let planes = launch_rasterize_rays(&gpu, &inputs, self.device_lists(&gpu, &inputs), &self.spec);
        split_planes(planes, &self.spec, args.tensor(0))
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0, 1, 2, 3, 4]
    }

    fn keeps_outputs(&self) -> bool {
        true
    }

    fn tracked(&self) -> Self {
        Self { trace: Some(TraceCell::default()), ..self.clone() }
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, of_planes) = (args.all::<F, 5>(), host_grads(args, &self.spec));
        let inputs = RayLayers::from_array(slices(&read));
        let kept = self.trace.as_ref().and_then(TraceCell::kept::<RayTrace<F>>);
        let lists = (self.host_lists(&inputs), kept);
        let needs = RayLayers::from_array(args.needs());
        let grads = rasterize_rays_backward_cpu(inputs, plane_slices(&of_planes), &self.spec, lists, needs);
        float_outputs(grads.into_array()).into_iter().chain([HostOutput::Nothing]).collect()
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, inputs) = (args.gpu(), RayLayers::from_array(args.all()));
        let grad = grad_of_planes(&args, &self.spec, false);
        let lists = (self.device_lists(&gpu, &inputs), ROOM);
        let needs = RayLayers::from_array(args.needs());
        let grads = launch_rasterize_rays_backward(&gpu, &inputs, &grad, lists, &self.spec, needs);
        optional_outputs(grads.into_array()).into_iter().chain([None]).collect()
    }
}
