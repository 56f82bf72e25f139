//! What each operation will return, said before it runs: Burn's fusion asks when it registers the operation.

use burn::backend::fusion::custom::TensorSpec;
use burn::tensor::{DType, Shape};

use crate::bind::activate::ActivateInputsMetadata;
use crate::blend::{BlendGradsMetadata, BlendInputsMetadata, BlendNeeds, BlendSpec, PartsCell, TraceCell};
use crate::op::SlotMetadata;
use crate::project::{COLUMNS, ProjectGradsMetadata, ProjectInputsMetadata, ProjectNeeds, ProjectSpec};
use crate::rays::{RaysGradsMetadata, RaysInputsMetadata, RaysNeeds};
use crate::shade::{ShadeGradsMetadata, ShadeInputsMetadata, ShadeNeeds};
use crate::tile::{HitCell, tile_grid};
use crate::tilt::TILT;

/// A gradient of the shape of `like`, if it is needed.
fn slot(needed: bool, like: &TensorSpec) -> SlotMetadata {
    if needed { SlotMetadata::Have(like.clone()) } else { SlotMetadata::Skip }
}

/// A tensor of the float type of `like`.
fn float<const D: usize>(shape: [usize; D], like: &TensorSpec) -> TensorSpec {
    TensorSpec::new(Shape::from(shape), like.dtype)
}

/// A tensor of the shape of one and the float type of another.
fn of_type(shape: &TensorSpec, like: &TensorSpec) -> TensorSpec {
    TensorSpec::new(shape.shape.clone(), like.dtype)
}

pub(crate) fn opacities(inputs: &ActivateInputsMetadata) -> TensorSpec {
    inputs.logit_opacities.clone()
}

pub(crate) fn project(inputs: &ProjectInputsMetadata, _: &TensorSpec, _: &ProjectSpec) -> TensorSpec {
    float([inputs.opacities.shape[0], COLUMNS], &inputs.means)
}

pub(crate) fn project_backward(
    inputs: &ProjectInputsMetadata,
    _: &TensorSpec,
    _: &ProjectSpec,
    needs: &ProjectNeeds,
) -> ProjectGradsMetadata {
    ProjectGradsMetadata {
        means: slot(needs.means, &inputs.means),
        rotations: slot(needs.rotations, &inputs.rotations),
        scales: slot(needs.scales, &inputs.scales),
        opacities: slot(needs.opacities, &inputs.opacities),
        cam_from_world: slot(needs.cam_from_world, &inputs.cam_from_world),
        mean2d: slot(needs.mean2d, &float([inputs.opacities.shape[0], 2], &inputs.means)),
    }
}

pub(crate) fn shade(inputs: &ShadeInputsMetadata, _: &SlotMetadata, _: &ProjectSpec) -> TensorSpec {
    inputs.means.clone()
}

pub(crate) fn shade_backward(
    inputs: &ShadeInputsMetadata,
    _: &SlotMetadata,
    _: &TensorSpec,
    _: &ProjectSpec,
    needs: &ShadeNeeds,
) -> ShadeGradsMetadata {
    ShadeGradsMetadata {
        sh: slot(needs.sh, &of_type(&inputs.sh, &inputs.means)),
        means: slot(needs.means, &inputs.means),
        cam_from_world: slot(needs.cam_from_world, &inputs.cam_from_world),
    }
}

pub(crate) fn tile(_: &TensorSpec, spec: &BlendSpec, _: &HitCell) -> TensorSpec {
    let [tiles_x, tiles_y] = tile_grid(spec.intrinsics.width, spec.intrinsics.height);
    TensorSpec::new(Shape::from([tiles_y, tiles_x]), DType::I32)
}

pub(crate) fn blend(
    inputs: &BlendInputsMetadata,
    _: &TensorSpec,
    _: &TensorSpec,
    spec: &BlendSpec,
    _: &HitCell,
    _: &Option<TraceCell>,
    _: &PartsCell,
) -> TensorSpec {
    let planes = spec.planes(inputs.background.shape[0]);
    float([planes, spec.intrinsics.height, spec.intrinsics.width], &inputs.projected)
}

pub(crate) fn part(planes: &TensorSpec, from: &usize, to: &usize, _: &PartsCell) -> TensorSpec {
    float([to - from, planes.shape[1], planes.shape[2]], planes)
}

pub(crate) fn blend_backward(
    inputs: &BlendInputsMetadata,
    _: &TensorSpec,
    _: &TensorSpec,
    _: &BlendSpec,
    needs: &BlendNeeds,
    _: &HitCell,
    _: &TraceCell,
) -> BlendGradsMetadata {
    BlendGradsMetadata {
        projected: slot(needs.projected, &inputs.projected),
        features: slot(needs.features, &inputs.features),
        background: slot(needs.background, &inputs.background),
        mean2d_abs: slot(needs.mean2d_abs, &float([inputs.projected.shape[0], 2], &inputs.projected)),
    }
}

pub(crate) fn tilt(inputs: &ProjectInputsMetadata, _: &ProjectSpec) -> TensorSpec {
    float([inputs.opacities.shape[0], TILT], &inputs.means)
}

pub(crate) fn tilt_backward(
    inputs: &ProjectInputsMetadata,
    grad: &TensorSpec,
    spec: &ProjectSpec,
    needs: &ProjectNeeds,
) -> ProjectGradsMetadata {
    project_backward(inputs, grad, spec, needs)
}

pub(crate) fn rays(
    inputs: &RaysInputsMetadata,
    _: &TensorSpec,
    _: &TensorSpec,
    spec: &BlendSpec,
    _: &HitCell,
    _: &PartsCell,
) -> TensorSpec {
    let planes = spec.planes(inputs.background.shape[0]);
    float([planes, spec.intrinsics.height, spec.intrinsics.width], &inputs.projected)
}

pub(crate) fn rays_backward(
    inputs: &RaysInputsMetadata,
    _: &TensorSpec,
    _: &TensorSpec,
    _: &BlendSpec,
    needs: &RaysNeeds,
    _: &HitCell,
) -> RaysGradsMetadata {
    RaysGradsMetadata {
        projected: slot(needs.projected, &inputs.projected),
        tilt: slot(needs.tilt, &inputs.tilt),
        features: slot(needs.features, &inputs.features),
        background: slot(needs.background, &inputs.background),
        mean2d_abs: slot(needs.mean2d_abs, &float([inputs.projected.shape[0], 2], &inputs.projected)),
    }
}
