//! The stages of a render, as an extension of Burn's backends.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, backend_extension};

#[cfg(feature = "fusion")]
use super::fusion;
use super::tensors::{
    GeometryGrads, GeometryTensors, LayerGrads, LayerTensors, OptionalTensor, PlaneGrads, RayLayerGrads,
    RayLayerTensors, ShadingGrads, ShadingTensors,
};
use crate::intersect::IntersectionCell;
#[cfg(feature = "fusion")]
use crate::project::COLUMNS;
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::{Layers, PartsCell, RasterizeSpec, TraceCell};
use crate::rasterize_rays::RayLayers;
#[cfg(feature = "fusion")]
use crate::ray_space;
use crate::sh::Shading;

/// Gaussian splatting on a Burn backend: the stages, and the backward passes of the differentiable ones.
///
/// With Burn's fusion, an operation on the GPU is registered first and runs later, on the device's own thread; `#[fusion]`
/// states the shape and type of its output.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait SplatBackend: Backend {
    /// Projects Gaussians; see `project/`. Returns `[N, 7]`.
    #[fusion(meta = |inputs, _| fusion::float([inputs.opacities.0.shape[0], COLUMNS], &inputs.means.0))]
    fn project(#[extension_type] inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self>;

    /// Returns the gradients of `project` that `mask` selects, from the gradient of its output.
    #[fusion(meta = |inputs, _, _, mask| inputs.each_ref().zip(*mask).map(fusion::grad(&inputs.means.0)))]
    fn project_backward(
        #[extension_type] inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self>;

    /// Evaluates colours; see `sh/`. Returns `[N, 3]`. With `visible`, the output of `project`, only Gaussians that are visible
    /// in the picture of `spec` get colours.
    #[fusion(meta = |inputs, _, _| inputs.means.0.clone())]
    fn evaluate_sh(
        #[extension_type] inputs: ShadingTensors<Self>,
        #[extension_type] visible: OptionalTensor<Self>,
        spec: ProjectSpec,
    ) -> FloatTensor<Self>;

    /// Returns the gradients of `evaluate_sh` that `mask` selects, from the gradient of its output.
    #[fusion(meta = |inputs, _, _, _, mask| inputs.each_ref().zip(*mask).map(fusion::grad(&inputs.means.0)))]
    fn sh_backward(
        #[extension_type] inputs: ShadingTensors<Self>,
        #[extension_type] visible: OptionalTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Shading<bool>,
    ) -> ShadingGrads<Self>;

    /// Fills `intersections` and returns the number of intersections per tile, `[tiles along y, tiles along x]`; see
    /// `intersect/`.
    #[fusion(meta = |_, spec, _| fusion::tile_counts(spec))]
    fn intersect(projected: FloatTensor<Self>, spec: RasterizeSpec, intersections: IntersectionCell)
    -> IntTensor<Self>;

    /// Rasterizes; see `rasterize/`. Returns planes `[C + 1 (+ 1), H, W]`, and fills `trace` if there is one.
    /// `intersection_counts` is the output of `intersect` and makes this operation run after it. Gradients pass through
    /// [`Self::part`] only.
    #[fusion(meta = |inputs, _, spec, _, _, _| fusion::planes(&inputs.background, spec))]
    fn rasterize(
        #[extension_type] inputs: LayerTensors<Self>,
        intersection_counts: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        trace: Option<TraceCell>,
        parts: PartsCell,
    ) -> FloatTensor<Self>;

    /// Returns the planes `from..to` of an output of `rasterize`, which was given the same `parts`. The first planes are a view
    /// where the backend supports views. Differentiable; the gradient is not copied if only this part has one.
    #[fusion(meta = |planes, from, to, _| fusion::float([to - from, planes.shape[1], planes.shape[2]], planes))]
    fn part(planes: FloatTensor<Self>, from: usize, to: usize, parts: PartsCell) -> FloatTensor<Self>;

    /// Returns the gradients of `rasterize` that `mask` selects, from those of its planes; an absent one is zero. `planes` is the output
    /// of `rasterize`; it makes this operation run after that one and is not read.
    #[fusion(meta = |inputs, _, _, _, mask, _, _| inputs.each_ref().zip(*mask).map(fusion::grad(&inputs.projected.0)))]
    fn rasterize_backward(
        #[extension_type] inputs: LayerTensors<Self>,
        planes: FloatTensor<Self>,
        #[extension_type] grads: PlaneGrads<Self>,
        spec: RasterizeSpec,
        mask: Layers<bool>,
        intersections: IntersectionCell,
        trace: TraceCell,
    ) -> LayerGrads<Self>;

    /// The Gaussians in ray space; see `ray_space/`. Returns `[N, 9]`, with a lens `[N, 15]`.
    #[fusion(meta = |inputs, spec| fusion::float(
        [inputs.opacities.0.shape[0], ray_space::columns(&spec.intrinsics)], &inputs.means.0))]
    fn ray_space(#[extension_type] inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self>;

    /// Returns the gradients of `ray_space` that `mask` selects, from the gradient of its output. Opacities have no gradient.
    #[fusion(meta = |inputs, _, _, mask| inputs.each_ref().zip(*mask).map(fusion::grad(&inputs.means.0)))]
    fn ray_space_backward(
        #[extension_type] inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self>;

    /// Returns bounds as rows `[N, 7]` for `intersect`, from packed ellipses `[N, 7]` and their rows in ray space; see
    /// `ray_space/`. Not differentiable.
    #[fusion(dtype = projected, shape = projected)]
    fn bounds(projected: FloatTensor<Self>, ray_space: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self>;

    /// Rasterizes along rays; see `rasterize_rays/`. Returns planes; they and the other arguments are as in `rasterize`. On GPUs no
    /// trace is kept.
    #[fusion(meta = |inputs, _, spec, _, _, _| fusion::planes(&inputs.background, spec))]
    fn rasterize_rays(
        #[extension_type] inputs: RayLayerTensors<Self>,
        intersection_counts: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        trace: Option<TraceCell>,
        parts: PartsCell,
    ) -> FloatTensor<Self>;

    /// Returns the gradients of `rasterize_rays` that `mask` selects; `planes` and `grads` are as in [`Self::rasterize_backward`].
    #[fusion(meta = |inputs, _, _, _, mask, _, _| inputs.each_ref().zip(*mask).map(fusion::grad(&inputs.projected.0)))]
    fn rasterize_rays_backward(
        #[extension_type] inputs: RayLayerTensors<Self>,
        planes: FloatTensor<Self>,
        #[extension_type] grads: PlaneGrads<Self>,
        spec: RasterizeSpec,
        mask: RayLayers<bool>,
        intersections: IntersectionCell,
        trace: TraceCell,
    ) -> RayLayerGrads<Self>;
}
