//! The stages of a render, as an extension of Burn's backends.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, backend_extension};

#[cfg(feature = "fusion")]
use super::fusion;
use super::tensors::{
    GeometryGrads, GeometryTensors, LayerGrads, LayerTensors, OptionalTensor, ShadingGrads, ShadingTensors,
};
use crate::intersect::IntersectionCell;
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::{Layers, PartsCell, RasterizeSpec, TraceCell};
use crate::sh::Shading;

/// Gaussian splatting on a Burn backend: four stages, and the backward pass of the three that have one.
///
/// With Burn's fusion, an operation on the GPU is registered first and runs later, on the device's own thread; the functions named
/// in `#[fusion]` say what it will return.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait SplatBackend: Backend {
    /// See `project/`. Returns `[N, 7]`.
    #[fusion(meta = fusion::project)]
    fn project(#[extension_type] inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self>;

    /// The gradients of `project` that `mask` asks for, from that of its output.
    #[fusion(meta = fusion::project_backward)]
    fn project_backward(
        #[extension_type] inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self>;

    /// See `sh/`. Returns `[N, 3]`. `visible` is what `project` returned, for colours of what shows in the picture of `spec` alone.
    #[fusion(meta = fusion::evaluate_sh)]
    fn evaluate_sh(
        #[extension_type] inputs: ShadingTensors<Self>,
        #[extension_type] visible: OptionalTensor<Self>,
        spec: ProjectSpec,
    ) -> FloatTensor<Self>;

    /// The gradients of `evaluate_sh` that `mask` asks for, from that of its output.
    #[fusion(meta = fusion::sh_backward)]
    fn sh_backward(
        #[extension_type] inputs: ShadingTensors<Self>,
        #[extension_type] visible: OptionalTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Shading<bool>,
    ) -> ShadingGrads<Self>;

    /// See `intersect/`. Fills `intersections` and returns the number of intersections per tile, `[tiles along y, tiles along x]`.
    #[fusion(meta = fusion::intersect)]
    fn intersect(projected: FloatTensor<Self>, spec: RasterizeSpec, intersections: IntersectionCell)
    -> IntTensor<Self>;

    /// See `rasterize/`. Returns `[C + 1 (+ 1), H, W]` and fills `trace` if it is to be kept. `intersection_counts` is what `intersect`
    /// returned, and orders the two; gradients come through [`Self::part`] alone.
    #[fusion(meta = fusion::rasterize)]
    fn rasterize(
        #[extension_type] inputs: LayerTensors<Self>,
        intersection_counts: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        trace: Option<TraceCell>,
        parts: PartsCell,
    ) -> FloatTensor<Self>;

    /// Planes `from` to before `to` of what `rasterize` returned, which was given the same `parts`. The first ones are a view
    /// where the backend knows views. Differentiable: without a copy if the part is all that has a gradient.
    #[fusion(meta = fusion::part)]
    fn part(planes: FloatTensor<Self>, from: usize, to: usize, parts: PartsCell) -> FloatTensor<Self>;

    /// The gradients of `rasterize` that `mask` asks for, from that of its output, or, where depth is not rendered and alpha has no
    /// gradient, of its first `C` planes. `planes` is what `rasterize` returned, and orders the two; not read.
    #[fusion(meta = fusion::rasterize_backward)]
    fn rasterize_backward(
        #[extension_type] inputs: LayerTensors<Self>,
        planes: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: RasterizeSpec,
        mask: Layers<bool>,
        intersections: IntersectionCell,
        trace: TraceCell,
    ) -> LayerGrads<Self>;
}
