//! Output shapes and types of the operations: Burn's fusion asks for them when it registers an operation, before it runs.

use burn::backend::fusion::custom::TensorSpec;
use burn::tensor::{DType, Shape};

use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::depth_slope::DEPTH_SLOPE;
use crate::intersect::{IntersectionCell, tile_grid};
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::rasterize::{Layers, PartsCell, RasterizeSpec, TraceCell};
use crate::rasterize_rays::RayLayers;
use crate::sh::Shading;

/// Returns the specification of a tensor with the float type of `like`.
fn float<const D: usize>(shape: [usize; D], like: &TensorSpec) -> TensorSpec {
    TensorSpec::new(Shape::from(shape), like.dtype)
}

/// Returns the specification of an input's gradient, with the input's shape and the float type of `like`, if it is asked for.
fn grad(input: &InputTensorMetadata, asked: bool, like: &TensorSpec) -> OptionalTensorMetadata {
    match asked {
        true => OptionalTensorMetadata::Present(TensorSpec::new(input.0.shape.clone(), like.dtype)),
        false => OptionalTensorMetadata::Absent,
    }
}

pub(super) fn project(inputs: &Geometry<InputTensorMetadata>, _: &ProjectSpec) -> TensorSpec {
    float([inputs.opacities.0.shape[0], COLUMNS], &inputs.means.0)
}

pub(super) fn project_backward(
    inputs: &Geometry<InputTensorMetadata>,
    _: &TensorSpec,
    _: &ProjectSpec,
    mask: &Geometry<bool>,
) -> Geometry<OptionalTensorMetadata> {
    inputs.each_ref().zip(*mask).map(|(input, asked)| grad(input, asked, &inputs.means.0))
}

pub(super) fn evaluate_sh(
    inputs: &Shading<InputTensorMetadata>,
    _: &OptionalTensorMetadata,
    _: &ProjectSpec,
) -> TensorSpec {
    inputs.means.0.clone()
}

pub(super) fn sh_backward(
    inputs: &Shading<InputTensorMetadata>,
    _: &OptionalTensorMetadata,
    _: &TensorSpec,
    _: &ProjectSpec,
    mask: &Shading<bool>,
) -> Shading<OptionalTensorMetadata> {
    inputs.each_ref().zip(*mask).map(|(input, asked)| grad(input, asked, &inputs.means.0))
}

pub(super) fn intersect(_: &TensorSpec, spec: &RasterizeSpec, _: &IntersectionCell) -> TensorSpec {
    let [tiles_x, tiles_y] = tile_grid(spec.intrinsics.width, spec.intrinsics.height);
    TensorSpec::new(Shape::from([tiles_y, tiles_x]), DType::I32)
}

fn planes(background: &InputTensorMetadata, spec: &RasterizeSpec) -> TensorSpec {
    let planes = spec.planes(background.0.shape[0]);
    float([planes, spec.intrinsics.height, spec.intrinsics.width], &background.0)
}

pub(super) fn rasterize(
    inputs: &Layers<InputTensorMetadata>,
    _: &TensorSpec,
    spec: &RasterizeSpec,
    _: &IntersectionCell,
    _: &Option<TraceCell>,
    _: &PartsCell,
) -> TensorSpec {
    planes(&inputs.background, spec)
}

pub(super) fn part(planes: &TensorSpec, from: &usize, to: &usize, _: &PartsCell) -> TensorSpec {
    float([to - from, planes.shape[1], planes.shape[2]], planes)
}

pub(super) fn rasterize_backward(
    inputs: &Layers<InputTensorMetadata>,
    _: &TensorSpec,
    _: &TensorSpec,
    _: &RasterizeSpec,
    mask: &Layers<bool>,
    _: &IntersectionCell,
    _: &TraceCell,
) -> Layers<OptionalTensorMetadata> {
    inputs.each_ref().zip(*mask).map(|(input, asked)| grad(input, asked, &inputs.projected.0))
}

pub(super) fn depth_slope(inputs: &Geometry<InputTensorMetadata>, _: &ProjectSpec) -> TensorSpec {
    float([inputs.opacities.0.shape[0], DEPTH_SLOPE], &inputs.means.0)
}

pub(super) fn rasterize_rays(
    inputs: &RayLayers<InputTensorMetadata>,
    _: &TensorSpec,
    spec: &RasterizeSpec,
    _: &IntersectionCell,
    _: &PartsCell,
) -> TensorSpec {
    planes(&inputs.background, spec)
}

pub(super) fn rasterize_rays_backward(
    inputs: &RayLayers<InputTensorMetadata>,
    _: &TensorSpec,
    _: &TensorSpec,
    _: &RasterizeSpec,
    mask: &RayLayers<bool>,
    _: &IntersectionCell,
) -> RayLayers<OptionalTensorMetadata> {
    inputs.each_ref().zip(*mask).map(|(input, asked)| grad(input, asked, &inputs.projected.0))
}
