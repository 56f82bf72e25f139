//! The rasterizer as an operation.

use std::any::Any;
use std::array;

use super::cpu::{Trace, rasterize_backward_cpu, rasterize_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_rasterize, launch_rasterize_backward};
#[cfg(feature = "cube")]
use super::trace::DeviceTrace;
use super::{Layers, PlaneParts, RasterizeSpec, TraceCell};
#[cfg(feature = "cube")]
use crate::backend::cube::{buffer, gpu_outputs, optional_outputs};
use crate::backend::host::{Host, float_outputs};
use crate::backend::*;
#[cfg(feature = "cube")]
use crate::gpu::{Buffer, Gpu};
use crate::intersect::IntersectionCell;
use crate::intersect::operation::lists;
#[cfg(feature = "cube")]
use crate::intersect::{Cut, launch::DeviceIntersections, launch::launch_intersect};
use crate::ray_space::bounds_cpu;
#[cfg(feature = "cube")]
use crate::ray_space::launch::launch_bounds;

/// Planes `[C, H, W]` of colours, `[1, H, W]` of alpha and, if asked for, of depth. Takes the tensors of [`Layers`] and the output of the
/// intersection, which makes this operation run after that one. Without rays there are no rows of `ray_space`.
#[derive(Clone, Debug)]
pub(crate) struct Rasterize {
    pub spec: RasterizeSpec,
    pub lists: IntersectionCell,
    /// Filled for the backward pass, if there is one.
    pub trace: Option<TraceCell>,
}

/// Returns the specifications of planes over a background.
fn planes(spec: &RasterizeSpec, background: Option<&Spec>) -> Vec<Option<Spec>> {
    let plane =
        |count: usize| background.map(|of| of.with_shape([count, spec.intrinsics.height, spec.intrinsics.width]));
    let features = background.map_or(0, |background| background.shape[0]);
    let mut all = vec![plane(features), plane(1)];
    all.extend(spec.options.depth.then(|| plane(1)));
    all
}

/// Splits planes `[C + 1 (+ 1), H, W]`.
fn split<F: Real>(mut planes: Vec<F>, spec: &RasterizeSpec) -> Vec<HostOutput> {
    let pixels = spec.intrinsics.width * spec.intrinsics.height;
    let depth = spec.options.depth.then(|| planes.split_off(planes.len() - pixels));
    let alpha = planes.split_off(planes.len() - pixels);
    float_outputs([planes, alpha].into_iter().chain(depth))
}

/// Reads the gradients of planes; an absent one has no elements.
fn host_grads<F: Real>(args: &HostArgs, spec: &RasterizeSpec) -> PlaneParts<Option<Host<F>>> {
    let depth = if spec.options.depth { args.grad(2) } else { None };
    PlaneParts { colour: args.grad(0), alpha: args.grad(1), depth }
}

fn plane_slices<F: Real>(grads: &PlaneParts<Option<Host<F>>>) -> PlaneParts<&[F]> {
    grads.each_ref().map(|grad| grad.as_ref().map_or(&[][..], |grad| &grad[..]))
}

/// Keeps the trace of a forward pass. A cell that is already filled holds the same trace.
fn keep<T: Any + Send + Sync>(cell: Option<&TraceCell>, kept: Option<T>) {
    if let (Some(cell), Some(kept)) = (cell, kept) {
        let _ = cell.0.set(Box::new(kept));
    }
}

impl TraceCell {
    pub(crate) fn kept<T: Any>(&self) -> Option<&T> {
        self.0.get().and_then(|kept| kept.downcast_ref())
    }
}

#[cfg(feature = "cube")]
use gpu::grad_of_planes;

#[cfg(feature = "cube")]
mod gpu {
    use burn::backend::ops::FloatTensorOps;
    use burn::tensor::DType;
    use burn_cubecl::CubeBackend;
    use burn_cubecl::tensor::CubeTensor;

    use super::*;

    /// Returns the gradient of all planes in one buffer, with zeros where a part has none. If `shortest` is set and only the colours have
    /// one, the result has theirs alone.
    pub(crate) fn grad_of_planes(args: &GpuArgs, spec: &RasterizeSpec, shortest: bool) -> Buffer<f32> {
        let colour = args.output(0);
        let zeros =
            |like: &CubeTensor| CubeBackend::float_zeros(like.meta.shape().clone(), &like.device, DType::F32.into());
        let part = |i: usize| args.grad(i).unwrap_or_else(|| zeros(args.output(i)));
        let mut parts = vec![args.grad(0).unwrap_or_else(|| zeros(colour))];
        if !(shortest && args.grad(1).is_none()) {
            parts.push(part(1));
            parts.extend(spec.options.depth.then(|| part(2)));
        }
        buffer(if parts.len() == 1 { parts.remove(0) } else { CubeBackend::float_cat(parts, 0) })
    }
}

/// Reads the inputs; absent rows of `ray_space` have no elements.
fn host_layers<F: Real>(args: &HostArgs) -> Layers<Option<Host<F>>> {
    Layers::from_array(array::from_fn(|i| args.has(i).then(|| args.floats(i))))
}

fn layer_slices<F: Real>(read: &Layers<Option<Host<F>>>) -> Layers<&[F]> {
    read.each_ref().map(|host| host.as_ref().map_or(&[][..], |host| &host[..]))
}

#[cfg(feature = "cube")]
fn device_layers(args: &GpuArgs, gpu: &Gpu) -> Layers<Buffer<f32>> {
    Layers::from_array(array::from_fn(|i| args.optional(i).unwrap_or_else(|| Buffer::new(gpu, 0))))
}

impl Rasterize {
    fn host_lists(&self, inputs: &Layers<&[impl Real]>) -> &crate::intersect::IntersectionLists {
        self.lists.on_host(|| match self.spec.options.along_rays() {
            true => lists(&bounds_cpu(inputs.projected, inputs.ray_space, &self.spec), &self.spec),
            false => lists(inputs.projected, &self.spec),
        })
    }

    #[cfg(feature = "cube")]
    fn device_lists(&self, gpu: &Gpu, inputs: &Layers<Buffer<f32>>) -> &DeviceIntersections {
        let RasterizeSpec { intrinsics, options } = &self.spec;
        self.lists.on_device(|| {
            let bounds =
                options.along_rays().then(|| launch_bounds(gpu, &inputs.projected, &inputs.ray_space, &self.spec));
            launch_intersect(gpu, bounds.as_ref().unwrap_or(&inputs.projected), intrinsics, Cut::of(options))
        })
    }
}

impl Operation for Rasterize {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        planes(&self.spec, inputs[2].as_ref())
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = host_layers::<F>(args);
        let inputs = layer_slices(&read);
        let (planes, kept) = rasterize_cpu(inputs, &self.spec, self.host_lists(&inputs), self.trace.is_some());
        keep(self.trace.as_ref(), kept);
        split(planes, &self.spec)
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let gpu = args.gpu();
        let inputs = device_layers(&args, &gpu);
        let lists = self.device_lists(&gpu, &inputs);
        let (planes, kept) = launch_rasterize(&gpu, &inputs, lists, &self.spec, self.trace.is_some());
        keep(self.trace.as_ref(), kept);
        // The device may have nothing else to do by now.
        gpu.begin();
        gpu_outputs(planes.parts())
    }

    fn differentiable(&self) -> &'static [usize] {
        if self.spec.options.along_rays() { &[0, 1, 2, 3, 4] } else { &[0, 1, 2, 3] }
    }

    // They make the backward pass run after this one, and are not read.
    fn keeps_outputs(&self) -> bool {
        true
    }

    fn tracked(&self) -> Self {
        Self { trace: Some(TraceCell::default()), ..self.clone() }
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, of_planes) = (host_layers::<F>(args), host_grads(args, &self.spec));
        let inputs = layer_slices(&read);
        let kept = self.trace.as_ref().and_then(TraceCell::kept::<Trace<F>>);
        let (lists, needs) = (self.host_lists(&inputs), Layers::from_array(args.needs()));
        let grads = rasterize_backward_cpu(inputs, plane_slices(&of_planes), &self.spec, lists, kept, needs);
        float_outputs(grads.into_array()).into_iter().chain([HostOutput::Nothing]).collect()
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let gpu = args.gpu();
        let inputs = device_layers(&args, &gpu);
        let grad = grad_of_planes(&args, &self.spec, !self.spec.options.depth);
        let lists = self.device_lists(&gpu, &inputs);
        let kept = self.trace.as_ref().and_then(TraceCell::kept::<DeviceTrace>).cloned();
        let kept = kept.unwrap_or_else(|| {
            launch_rasterize(&gpu, &inputs, lists, &self.spec, true).1.expect("a trace was asked for")
        });
        let needs = Layers::from_array(args.needs());
        let found = launch_rasterize_backward(&gpu, &inputs, &grad, lists, &kept, &self.spec, needs);
        optional_outputs(found.into_array()).into_iter().chain([None]).collect()
    }
}
