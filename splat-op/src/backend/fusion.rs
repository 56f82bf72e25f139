//! Output shapes and types of the operations: Burn's fusion asks for them when it registers an operation, before it runs.

use burn::backend::fusion::custom::TensorSpec;
use burn::tensor::{DType, Shape};

use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::intersect::tile_grid;
use crate::rasterize::RasterizeSpec;

/// Returns the specification of a tensor with the float type of `like`.
pub(super) fn float<const D: usize>(shape: [usize; D], like: &TensorSpec) -> TensorSpec {
    TensorSpec::new(Shape::from(shape), like.dtype)
}

/// Returns a function to the specification of an input's gradient, with the input's shape and the float type of `like`, if it is
/// asked for.
pub(super) fn grad(like: &TensorSpec) -> impl Fn((&InputTensorMetadata, bool)) -> OptionalTensorMetadata {
    |(input, asked)| match asked {
        true => OptionalTensorMetadata::Present(TensorSpec::new(input.0.shape.clone(), like.dtype)),
        false => OptionalTensorMetadata::Absent,
    }
}

/// Returns the specification of the number of intersections per tile.
pub(super) fn tile_counts(spec: &RasterizeSpec) -> TensorSpec {
    let [tiles_x, tiles_y] = tile_grid(spec.intrinsics.width, spec.intrinsics.height);
    TensorSpec::new(Shape::from([tiles_y, tiles_x]), DType::I32)
}

/// Returns the specification of planes over a background.
pub(super) fn planes(background: &InputTensorMetadata, spec: &RasterizeSpec) -> TensorSpec {
    let planes = spec.planes(background.0.shape[0]);
    float([planes, spec.intrinsics.height, spec.intrinsics.width], &background.0)
}
