//! The stages on Burn's CPU backends: each method reads its tensors, picks the float type and calls the twin.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use std::any::Any;

use burn::backend::ops::{FloatTensorOps, IntTensorOps};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Flex, NdArray, TensorMetadata};
use burn::tensor::{Slice, TensorData};

use super::host::{Host, HostBackend, HostCoefficients, by_type};
use super::stages::SplatBackend;
use super::tensors::{
    GeometryGrads, GeometryTensors, InputTensor, LayerGrads, LayerTensors, OptionalTensor, PlaneGrads, RayLayerGrads,
    RayLayerTensors, ShadingGrads, ShadingTensors,
};
use crate::intersect::cpu::intersect_cpu;
use crate::intersect::{Cut, IntersectionCell, IntersectionLists, StoredIntersections, tile_grid};
use crate::project::cpu::{project_backward_cpu, project_cpu};
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::rasterize::cpu::{Trace, rasterize_backward_cpu, rasterize_cpu};
use crate::rasterize::{Layers, PartsCell, PlaneParts, RasterizeSpec, TraceCell};
use crate::rasterize_rays::RayLayers;
use crate::rasterize_rays::cpu::{RayTrace, rasterize_rays_backward_cpu, rasterize_rays_cpu};
use crate::ray_space::cpu::{ray_space_backward_cpu, ray_space_cpu};
use crate::ray_space::{bounds_cpu, columns};
use crate::sh::Shading;
use crate::sh::cpu::{ShCpuInputs, Visible, sh_backward_cpu, sh_cpu};
use crate::simd::real::Real;

/// Reads the elements of an input.
pub(super) fn host<B: HostBackend, F: Real>(input: &InputTensor<B>) -> Host<F> {
    B::host(input.0.clone())
}

/// Returns the gradient of an input as a tensor of its shape and of the float type of the elements, if it was asked for.
pub(super) fn gradient<B: HostBackend, F: Real>(
    ((elements, asked), input): ((Vec<F>, bool), &InputTensor<B>),
) -> OptionalTensor<B> {
    match asked {
        true => OptionalTensor::Present(B::from_host(elements, &input.0.shape(), &input.0)),
        false => OptionalTensor::Absent,
    }
}

/// Inputs of the spherical-harmonics (SH) stage: the coefficients, and everything else that colours depend on.
struct ShHost<F: Real> {
    sh: HostCoefficients<F>,
    means: Host<F>,
    cam_from_world: Host<F>,
    /// Packed ellipses, if only visible Gaussians need colours.
    ellipses: Option<Host<F>>,
    coefficients: usize,
}

impl<F: Real> ShHost<F> {
    fn read<B: HostBackend>(inputs: &ShadingTensors<B>, visible: OptionalTensor<B>) -> Self {
        Self {
            sh: B::host_coefficients(inputs.sh.0.clone()),
            means: host(&inputs.means),
            cam_from_world: host(&inputs.cam_from_world),
            ellipses: visible.into_option().map(B::host),
            coefficients: inputs.sh.0.shape()[1],
        }
    }

    fn inputs(&self) -> ShCpuInputs<'_, F> {
        let Self { means, cam_from_world, coefficients, .. } = self;
        ShCpuInputs { sh: self.sh.view(), means, cam_from_world, coefficients: *coefficients }
    }

    fn visible(&self, spec: &ProjectSpec) -> Option<Visible<'_, F>> {
        self.ellipses.as_deref().map(|ellipses| Visible::new(ellipses, spec))
    }
}

/// Returns the lists in the cell, computing them if it is empty.
fn intersection_lists<'a, F: Real>(
    cell: &'a IntersectionCell,
    projected: &[F],
    spec: &RasterizeSpec,
) -> &'a IntersectionLists {
    intersection_lists_by(cell, || intersect_cpu(projected, &spec.intrinsics, Cut::of(&spec.options)))
}

/// Returns the lists in the cell, filling it by `compute` if it is empty.
fn intersection_lists_by(cell: &IntersectionCell, compute: impl FnOnce() -> IntersectionLists) -> &IntersectionLists {
    match cell.0.get_or_init(|| StoredIntersections::Host(compute())) {
        StoredIntersections::Host(lists) => lists,
        #[cfg(feature = "cube")]
        StoredIntersections::Device(_) => {
            unreachable!("the public functions check that lists and ellipses are on one device")
        }
    }
}

/// Returns planes as a tensor. The number of feature channels is the length of `background`.
fn planes_tensor<B: HostBackend, F: Real>(
    planes: Vec<F>,
    spec: &RasterizeSpec,
    background: &InputTensor<B>,
) -> FloatTensor<B> {
    let count = spec.planes(background.0.shape()[0]);
    B::from_host(planes, &[count, spec.intrinsics.height, spec.intrinsics.width], &background.0)
}

/// Reads the gradients of planes; an absent one has no elements.
fn host_grads<B: HostBackend, F: Real>(grads: PlaneGrads<B>) -> PlaneParts<Option<Host<F>>> {
    grads.map(|grad| grad.into_option().map(B::host))
}

fn plane_slices<F: Real>(grads: &PlaneParts<Option<Host<F>>>) -> PlaneParts<&[F]> {
    grads.each_ref().map(|grad| grad.as_ref().map_or(&[][..], |grad| &grad[..]))
}

/// Returns the lists of a render along rays, computing them if the cell is empty.
fn ray_lists<'a, F: Real>(
    intersections: &'a IntersectionCell,
    inputs: RayLayers<&[F]>,
    spec: &RasterizeSpec,
) -> &'a IntersectionLists {
    intersection_lists_by(intersections, || {
        let bounds = bounds_cpu(inputs.projected, inputs.ray_space, spec);
        intersect_cpu(&bounds, &spec.intrinsics, Cut::of(&spec.options))
    })
}

/// Keeps the trace of a forward pass.
fn keep_trace<T: Any + Send + Sync>(cell: Option<TraceCell>, kept: Option<T>) {
    if let (Some(cell), Some(kept)) = (cell, kept) {
        // A cell that is already filled holds the same trace.
        let _ = cell.0.set(Box::new(kept));
    }
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl SplatBackend for $backend {
            fn project(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
                by_type!(inputs.means.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let packed = project_cpu(read.each_ref().map(|host| &host[..]), &spec);
                    let count = packed.len() / COLUMNS;
                    Self::from_host(packed, &[count, COLUMNS], &inputs.means.0)
                })
            }

            fn project_backward(
                inputs: GeometryTensors<Self>,
                grad: FloatTensor<Self>,
                spec: ProjectSpec,
                mask: Geometry<bool>,
            ) -> GeometryGrads<Self> {
                by_type!(inputs.means.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = project_backward_cpu(slices, &Self::host(grad), &spec, mask);
                    found.zip(mask).zip(inputs.each_ref()).map(gradient)
                })
            }

            fn evaluate_sh(
                inputs: ShadingTensors<Self>,
                visible: OptionalTensor<Self>,
                spec: ProjectSpec,
            ) -> FloatTensor<Self> {
                by_type!(inputs.means.0, F => {
                    let read = ShHost::<F>::read(&inputs, visible);
                    let colours = sh_cpu(read.inputs(), read.visible(&spec).as_ref());
                    Self::from_host(colours, &inputs.means.0.shape(), &inputs.means.0)
                })
            }

            fn sh_backward(
                inputs: ShadingTensors<Self>,
                visible: OptionalTensor<Self>,
                grad: FloatTensor<Self>,
                spec: ProjectSpec,
                mask: Shading<bool>,
            ) -> ShadingGrads<Self> {
                by_type!(inputs.means.0, F => {
                    let read = ShHost::<F>::read(&inputs, visible);
                    let visible = read.visible(&spec);
                    let found = sh_backward_cpu(read.inputs(), visible.as_ref(), &Self::host(grad), mask);
                    found.zip(mask).zip(inputs.each_ref()).map(gradient)
                })
            }

            fn intersect(projected: FloatTensor<Self>, spec: RasterizeSpec, intersections: IntersectionCell) -> IntTensor<Self> {
                let device = projected.device();
                let lists = by_type!(projected, F => intersection_lists(&intersections, &Self::host::<F>(projected), &spec));
                let counts: Vec<i32> = lists.tile_start.windows(2).map(|w| (w[1] - w[0]) as i32).collect();
                let [tiles_x, tiles_y] = tile_grid(spec.intrinsics.width, spec.intrinsics.height);
                Self::int_from_data(TensorData::new(counts, [tiles_y, tiles_x]), &device)
            }

            fn rasterize(
                inputs: LayerTensors<Self>,
                _: IntTensor<Self>,
                spec: RasterizeSpec,
                intersections: IntersectionCell,
                trace: Option<TraceCell>,
                _: PartsCell,
            ) -> FloatTensor<Self> {
                by_type!(inputs.projected.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let lists = intersection_lists(&intersections, slices.projected, &spec);
                    let (planes, kept) = rasterize_cpu(slices, &spec, lists, trace.is_some());
                    keep_trace(trace, kept);
                    planes_tensor(planes, &spec, &inputs.background)
                })
            }

            fn part(planes: FloatTensor<Self>, from: usize, to: usize, _: PartsCell) -> FloatTensor<Self> {
                let [_, height, width] = planes.shape().dims();
                Self::float_slice(planes, &[from..to, 0..height, 0..width].map(Slice::from))
            }

            fn rasterize_backward(
                inputs: LayerTensors<Self>,
                _: FloatTensor<Self>,
                grads: PlaneGrads<Self>,
                spec: RasterizeSpec,
                mask: Layers<bool>,
                intersections: IntersectionCell,
                trace: TraceCell,
            ) -> LayerGrads<Self> {
                by_type!(inputs.projected.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let lists = intersection_lists(&intersections, slices.projected, &spec);
                    let grads = host_grads::<Self, F>(grads);
                    let kept = trace.0.get().and_then(|kept| kept.downcast_ref::<Trace<F>>());
                    let found = rasterize_backward_cpu(slices, plane_slices(&grads), &spec, (lists, kept), mask);
                    found.zip(mask).zip(inputs.each_ref()).map(gradient)
                })
            }

            fn ray_space(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
                by_type!(inputs.means.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let ray_rows = ray_space_cpu(read.each_ref().map(|host| &host[..]), &spec);
                    let columns = columns(&spec.intrinsics);
                    let count = ray_rows.len() / columns;
                    Self::from_host(ray_rows, &[count, columns], &inputs.means.0)
                })
            }

            fn ray_space_backward(
                inputs: GeometryTensors<Self>,
                grad: FloatTensor<Self>,
                spec: ProjectSpec,
                mask: Geometry<bool>,
            ) -> GeometryGrads<Self> {
                by_type!(inputs.means.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = ray_space_backward_cpu(slices, &Self::host(grad), &spec, mask);
                    found.zip(mask).zip(inputs.each_ref()).map(gradient)
                })
            }

            fn bounds(projected: FloatTensor<Self>, ray_space: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self> {
                by_type!(projected, F => {
                    let like = projected.clone();
                    let rows = bounds_cpu::<F>(&Self::host(projected), &Self::host(ray_space), &spec);
                    let count = rows.len() / COLUMNS;
                    Self::from_host(rows, &[count, COLUMNS], &like)
                })
            }

            fn rasterize_rays(
                inputs: RayLayerTensors<Self>,
                _: IntTensor<Self>,
                spec: RasterizeSpec,
                intersections: IntersectionCell,
                trace: Option<TraceCell>,
                _: PartsCell,
            ) -> FloatTensor<Self> {
                by_type!(inputs.projected.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let lists = ray_lists(&intersections, slices, &spec);
                    let (planes, kept) = rasterize_rays_cpu(slices, &spec, lists, trace.is_some());
                    keep_trace(trace, kept);
                    planes_tensor(planes, &spec, &inputs.background)
                })
            }

            fn rasterize_rays_backward(
                inputs: RayLayerTensors<Self>,
                _: FloatTensor<Self>,
                grads: PlaneGrads<Self>,
                spec: RasterizeSpec,
                mask: RayLayers<bool>,
                intersections: IntersectionCell,
                trace: TraceCell,
            ) -> RayLayerGrads<Self> {
                by_type!(inputs.projected.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let lists = ray_lists(&intersections, slices, &spec);
                    let grads = host_grads::<Self, F>(grads);
                    let kept = trace.0.get().and_then(|kept| kept.downcast_ref::<RayTrace<F>>());
                    let found = rasterize_rays_backward_cpu(slices, plane_slices(&grads), &spec, (lists, kept), mask);
                    found.zip(mask).zip(inputs.each_ref()).map(gradient)
                })
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);
