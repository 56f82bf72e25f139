//! The extension trait that each backend implements.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, ExtensionType, backend_extension};

use crate::blend::{BlendGrads, BlendInputs, BlendNeeds, BlendSpec, PartsCell, TraceCell};
use crate::project::{ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::shade::{ShadeGrads, ShadeInputs, ShadeNeeds};
use crate::tile::HitCell;

#[cfg(feature = "fusion")]
use crate::bind::fusion;

/// A gradient that was asked for, or not; as an input, a tensor that there is, or not.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub enum Slot<B: Backend> {
    /// Its input is not tracked, or there is none.
    Skip,
    /// The gradient, or the input.
    Have(FloatTensor<B>),
}

impl<B: Backend> Slot<B> {
    /// What is in it.
    pub(crate) fn as_ref(&self) -> Option<&FloatTensor<B>> {
        match self {
            Self::Skip => None,
            Self::Have(tensor) => Some(tensor),
        }
    }
}

/// Gaussian splatting on a Burn backend: four stages, and the backward pass of the three that have one.
///
/// No method has a default body: a backend that lacks one does not compile. Users call the functions of this crate, which
/// take tensors and check them; these methods take backend primitives of the documented shapes and one float type.
///
/// With Burn's fusion, an operation on the GPU is registered first and runs later, on the device's own thread; the
/// functions named in `#[fusion]` say what it will return.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait SplatBackend: Backend {
    /// See `project/`. Returns `[N, 7]`. `mean2d_probe` is `[N, 2]`, or `[0, 2]` for none; its values are not read.
    #[fusion(meta = fusion::project)]
    fn project(
        #[extension_type] inputs: ProjectInputs<Self>,
        mean2d_probe: FloatTensor<Self>,
        spec: ProjectSpec,
    ) -> FloatTensor<Self>;

    /// Gradients of `project` from that of its output.
    #[fusion(meta = fusion::project_backward)]
    fn project_backward(
        #[extension_type] inputs: ProjectInputs<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ProjectNeeds,
    ) -> ProjectGrads<Self>;

    /// See `shade/`. Returns `[N, 3]`. `visible` is what `project` returned, for colours of what shows in the picture of
    /// `spec` alone.
    #[fusion(meta = fusion::shade)]
    fn shade(
        #[extension_type] inputs: ShadeInputs<Self>,
        #[extension_type] visible: Slot<Self>,
        spec: ProjectSpec,
    ) -> FloatTensor<Self>;

    /// Gradients of `shade` from that of its output.
    #[fusion(meta = fusion::shade_backward)]
    fn shade_backward(
        #[extension_type] inputs: ShadeInputs<Self>,
        #[extension_type] visible: Slot<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ShadeNeeds,
    ) -> ShadeGrads<Self>;

    /// See `tile/`. Fills `hits` and returns the number of hits per tile, `[tiles along y, tiles along x]`.
    #[fusion(meta = fusion::tile)]
    fn tile(projected: FloatTensor<Self>, spec: BlendSpec, hits: HitCell) -> IntTensor<Self>;

    /// See `blend/`. Returns `[C + 1 (+ 1), H, W]` and fills `trace` if it is to be kept. `tile_counts` is what `tile`
    /// returned, and orders the two; gradients come through [`Self::part`] alone. `mean2d_abs_probe` is `[N, 2]`, or `[0, 2]`
    /// for none, and not read.
    #[fusion(meta = fusion::blend)]
    fn blend(
        #[extension_type] inputs: BlendInputs<Self>,
        mean2d_abs_probe: FloatTensor<Self>,
        tile_counts: IntTensor<Self>,
        spec: BlendSpec,
        hits: HitCell,
        trace: Option<TraceCell>,
        parts: PartsCell,
    ) -> FloatTensor<Self>;

    /// Planes `from` to before `to` of what `blend` returned, which was given the same `parts`. The first ones are a view
    /// where the backend knows views. Differentiable: without a copy if the part is all that has a gradient.
    #[fusion(meta = fusion::part)]
    fn part(planes: FloatTensor<Self>, from: usize, to: usize, parts: PartsCell) -> FloatTensor<Self>;

    /// Gradients of `blend` from that of its output, or, where depth is not rendered and alpha has no gradient, of its first
    /// `C` planes. `planes` is what `blend` returned, and orders the two; not read.
    #[fusion(meta = fusion::blend_backward)]
    fn blend_backward(
        #[extension_type] inputs: BlendInputs<Self>,
        planes: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: BlendSpec,
        needs: BlendNeeds,
        hits: HitCell,
        trace: TraceCell,
    ) -> BlendGrads<Self>;
}
