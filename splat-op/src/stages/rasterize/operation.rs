//! The rasterizer as an operation.

use std::array;

#[cfg(feature = "cube")]
use super::contributors::launch_contributors;
use super::contributors_cpu::contributors_cpu;
use super::cpu::{Trace, rasterize_backward_cpu, rasterize_cpu};
use super::footprint::EllipseFootprint;
#[cfg(feature = "cube")]
use super::launch::{launch_rasterize, launch_rasterize_backward};
#[cfg(feature = "cube")]
use super::trace::DeviceTrace;
use super::{Layers, PlaneParts, RasterizeSpec};
use crate::backend::*;
use crate::camera::Intrinsics;
#[cfg(feature = "cube")]
use crate::gpu::{Buffer, Gpu};
use crate::intersect::Kept;
use crate::rasterize_rays::footprint::RayFootprint;

/// Planes `[C, H, W]` of colours, `[1, H, W]` of alpha and, if asked for, of depth. Takes the tensors of [`Layers`] and the output of the
/// intersection, which makes this operation run after that one. Without rays there are no rows of `ray_space`.
#[derive(Clone, Debug)]
pub(crate) struct Rasterize {
    pub spec: RasterizeSpec,
    pub lists: Kept,
    /// What the forward pass keeps for the backward pass, if there is one; a backward pass that finds nothing computes it again.
    pub trace: Option<Kept>,
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

/// Returns the elements of a tensor; an absent one has none.
fn slice<F: Real>(host: &Option<Host<F>>) -> &[F] {
    host.as_deref().unwrap_or_default()
}

/// Returns the gradient of all planes in one buffer, with zeros where a part has none. Without depth, and if only the colours have one,
/// the result has theirs alone.
#[cfg(feature = "cube")]
fn grad_of_planes(args: &GpuArgs, spec: &RasterizeSpec) -> Buffer<f32> {
    use burn::backend::ops::FloatTensorOps;
    use burn::tensor::DType;
    use burn_cubecl::CubeBackend;
    use burn_cubecl::tensor::CubeTensor;

    let zeros = |of: &CubeTensor| CubeBackend::float_zeros(of.meta.shape().clone(), &of.device, DType::F32.into());
    let part = |i: usize| args.grad(i).unwrap_or_else(|| zeros(args.output(i)));
    let count = if spec.options.depth { 3 } else { 1 + usize::from(args.grad(1).is_some()) };
    let mut parts: Vec<CubeTensor> = (0..count).map(part).collect();
    buffer(if count == 1 { parts.remove(0) } else { CubeBackend::float_cat(parts, 0) })
}

fn host_layers<F: Real>(args: &HostArgs) -> Layers<Option<Host<F>>> {
    Layers::from_array(array::from_fn(|i| args.has(i).then(|| args.floats(i))))
}

#[cfg(feature = "cube")]
fn device_layers(args: &GpuArgs, gpu: &Gpu) -> Layers<Buffer<f32>> {
    Layers::from_array(array::from_fn(|i| args.optional(i).unwrap_or_else(|| Buffer::new(gpu, 0))))
}

impl Operation for Rasterize {
    // They make the backward pass run after this one, and are not read.
    const KEEPS_OUTPUTS: bool = true;

    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        planes(&self.spec, inputs[2].as_ref())
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = host_layers::<F>(args);
        let inputs = read.each_ref().map(slice);
        let (planes, kept) = rasterize_cpu(inputs, &self.spec, self.lists.read(), self.trace.is_some());
        self.trace.iter().zip(kept).for_each(|(trace, kept)| trace.keep(kept));
        split(planes, &self.spec)
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let gpu = args.gpu();
        let (inputs, lists) = (device_layers(&args, &gpu), self.lists.read());
        let (planes, kept) = launch_rasterize(&gpu, &inputs, lists, &self.spec, self.trace.is_some());
        self.trace.iter().zip(kept).for_each(|(trace, kept)| trace.keep(kept));
        // The device may have nothing else to do by now.
        gpu.begin();
        gpu_outputs(planes.parts())
    }

    fn differentiable(&self) -> &'static [usize] {
        if self.spec.options.along_rays() { &[0, 1, 2, 3, 4] } else { &[0, 1, 2, 3] }
    }

    fn tracked(&self) -> Self {
        Self { trace: Some(Kept::default()), ..self.clone() }
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, of_planes) = (host_layers::<F>(args), host_grads::<F>(args, &self.spec));
        let (inputs, of_planes) = (read.each_ref().map(slice), of_planes.each_ref().map(slice));
        let kept = self.trace.as_ref().and_then(Kept::kept::<Trace<F>>);
        let (lists, needs) = (self.lists.read(), Layers::from_array(args.needs()));
        let grads = rasterize_backward_cpu(inputs, of_planes, &self.spec, lists, kept, needs);
        float_outputs(grads.into_array()).into_iter().chain([HostOutput::Nothing]).collect()
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let gpu = args.gpu();
        let (inputs, lists) = (device_layers(&args, &gpu), self.lists.read());
        let grad = grad_of_planes(&args, &self.spec);
        let kept = self.trace.as_ref().and_then(Kept::kept::<DeviceTrace>).cloned();
        let kept = kept.unwrap_or_else(|| {
            launch_rasterize(&gpu, &inputs, lists, &self.spec, true).1.expect("a trace was asked for")
        });
        let needs = Layers::from_array(args.needs());
        let found = launch_rasterize_backward(&gpu, &inputs, &grad, lists, &kept, &self.spec, needs);
        gpu_outputs(found.into_array()).into_iter().chain([None]).collect()
    }
}

/// Ids `[H, W, K]`, weights `[H, W, K]` and the id of the median `[H, W]` of the contributors of each pixel. Takes the inputs of
/// [`Rasterize`], of which the ellipses, the rows of `ray_space` and the output of the intersection are read. Not differentiable.
#[derive(Clone, Debug)]
pub(crate) struct Contribute {
    pub spec: RasterizeSpec,
    pub lists: Kept,
    /// Number of contributors of a pixel, `K`.
    pub most: usize,
}

impl Operation for Contribute {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let Intrinsics { width, height, .. } = self.spec.intrinsics;
        let each = [height, width, self.most];
        let weights = inputs[0].as_ref().map(|projected| projected.with_shape(each));
        vec![Some(Spec::ints(each)), weights, Some(Spec::ints([height, width]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = host_layers::<F>(args);
        let twin = match self.spec.options.along_rays() {
            true => contributors_cpu::<F, RayFootprint<F>>,
            false => contributors_cpu::<F, EllipseFootprint<F>>,
        };
        let found = twin(read.each_ref().map(slice), &self.spec, self.lists.read(), self.most);
        vec![HostOutput::ints(found.ids), HostOutput::floats(found.weights), HostOutput::ints(found.median)]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let gpu = args.gpu();
        launch_contributors(&gpu, &device_layers(&args, &gpu), self.lists.read(), &self.spec, self.most)
    }
}
