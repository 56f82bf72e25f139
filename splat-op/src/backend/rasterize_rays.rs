//! `depth_slope` and `rasterize_rays` on Burn's CPU backends.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::cpu::{gradient, host, intersection_lists_by, planes_tensor};
#[cfg(feature = "fusion")]
use super::fusion;
use super::host::{HostBackend, by_type};
use super::tensors::{GeometryGrads, GeometryTensors, RayLayerGrads, RayLayerTensors};
use crate::depth_slope::cpu::{depth_slope_backward_cpu, depth_slope_cpu};
use crate::depth_slope::{DEPTH_SLOPE, bounds_cpu};
use crate::intersect::cpu::intersect_cpu;
use crate::intersect::{Cut, IntersectionCell, IntersectionLists};
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::rasterize::{PartsCell, RasterizeSpec};
use crate::rasterize_rays::RayLayers;
use crate::rasterize_rays::cpu::{rasterize_rays_backward_cpu, rasterize_rays_cpu};
use crate::simd::real::Real;

/// The stages of per-ray rasterization.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait RasterizeRaysBackend: Backend {
    /// Ray-space depth slopes; see `depth_slope/`. Returns `[N, 3]`.
    #[fusion(meta = fusion::depth_slope)]
    fn depth_slope(#[extension_type] inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self>;

    /// Returns the gradients of `depth_slope` that `mask` selects, from the gradient of its output. Opacities and projected
    /// centres have no gradient.
    #[fusion(meta = fusion::project_backward)]
    fn depth_slope_backward(
        #[extension_type] inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self>;

    /// Returns bounds as rows `[N, 7]` for `intersect`, from packed ellipses `[N, 7]` and depth slopes `[N, 3]`; see
    /// `depth_slope/`. Not differentiable.
    #[fusion(dtype = projected, shape = projected)]
    fn bounds(projected: FloatTensor<Self>, depth_slope: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self>;

    /// Rasterizes along rays; see `rasterize_rays/`. Returns planes; they, `intersection_counts` and `parts` are as in
    /// `rasterize`.
    #[fusion(meta = fusion::rasterize_rays)]
    fn rasterize_rays(
        #[extension_type] inputs: RayLayerTensors<Self>,
        intersection_counts: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        parts: PartsCell,
    ) -> FloatTensor<Self>;

    /// Returns the gradients of `rasterize_rays` that `mask` selects, from the gradient of all its planes. `planes` is the output
    /// of `rasterize_rays`; it makes this operation run after that one and is not read.
    #[fusion(meta = fusion::rasterize_rays_backward)]
    fn rasterize_rays_backward(
        #[extension_type] inputs: RayLayerTensors<Self>,
        planes: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: RasterizeSpec,
        mask: RayLayers<bool>,
        intersections: IntersectionCell,
    ) -> RayLayerGrads<Self>;
}

/// Returns the lists in the cell, computing them if it is empty.
fn lists<'a, F: Real>(
    intersections: &'a IntersectionCell,
    inputs: RayLayers<&[F]>,
    spec: &RasterizeSpec,
) -> &'a IntersectionLists {
    intersection_lists_by(intersections, || {
        let rows = |packed: &[F]| intersect_cpu(packed, &spec.intrinsics, Cut::of(&spec.options));
        match spec.options.extends_by_bounds() {
            true => rows(&bounds_cpu(inputs.projected, inputs.depth_slope, spec)),
            false => rows(inputs.projected),
        }
    })
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl RasterizeRaysBackend for $backend {
            fn depth_slope(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
                by_type!(inputs.means.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let depth_slopes = depth_slope_cpu(read.each_ref().map(|host| &host[..]), &spec);
                    let count = depth_slopes.len() / DEPTH_SLOPE;
                    Self::from_host(depth_slopes, &[count, DEPTH_SLOPE], &inputs.means.0)
                })
            }

            fn depth_slope_backward(
                inputs: GeometryTensors<Self>,
                grad: FloatTensor<Self>,
                spec: ProjectSpec,
                mask: Geometry<bool>,
            ) -> GeometryGrads<Self> {
                by_type!(inputs.means.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = depth_slope_backward_cpu(slices, &Self::host(grad), &spec, mask);
                    found.zip(mask).zip(inputs.each_ref()).map(gradient)
                })
            }

            fn bounds(projected: FloatTensor<Self>, depth_slope: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self> {
                by_type!(projected, F => {
                    let like = projected.clone();
                    let rows = bounds_cpu::<F>(&Self::host(projected), &Self::host(depth_slope), &spec);
                    let count = rows.len() / COLUMNS;
                    Self::from_host(rows, &[count, COLUMNS], &like)
                })
            }

            fn rasterize_rays(
                inputs: RayLayerTensors<Self>,
                _: IntTensor<Self>,
                spec: RasterizeSpec,
                intersections: IntersectionCell,
                _: PartsCell,
            ) -> FloatTensor<Self> {
                by_type!(inputs.projected.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let planes = rasterize_rays_cpu(slices, &spec, lists(&intersections, slices, &spec));
                    planes_tensor(planes, &spec, &inputs.background)
                })
            }

            fn rasterize_rays_backward(
                inputs: RayLayerTensors<Self>,
                _: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                spec: RasterizeSpec,
                mask: RayLayers<bool>,
                intersections: IntersectionCell,
            ) -> RayLayerGrads<Self> {
                by_type!(inputs.projected.0, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let lists = lists(&intersections, slices, &spec);
                    let found = rasterize_rays_backward_cpu(slices, &Self::host(grad), &spec, lists, mask);
                    found.zip(mask).zip(inputs.each_ref()).map(gradient)
                })
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);
