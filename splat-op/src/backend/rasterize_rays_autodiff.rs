//! Backward nodes of `depth_slope` and `rasterize_rays`.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::tensor::{FloatTensor, IntTensor};

use super::autodiff::{differentiate, planes_grad, tracked};
use super::rasterize_rays::RasterizeRaysBackend;
use super::stages::SplatBackend;
use super::tensors::{GeometryGrads, GeometryTensors, InputTensor, OptionalTensor, RayLayerGrads, RayLayerTensors};
use crate::intersect::IntersectionCell;
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::{PartsCell, RasterizeSpec};
use crate::rasterize_rays::RayLayers;

#[derive(Debug)]
struct DepthSlopeBackward;

impl<B: RasterizeRaysBackend> Backward<B, 4> for DepthSlopeBackward {
    type State = (GeometryTensors<B>, ProjectSpec);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        differentiate::<B, _, _>(ops, grads, |(inputs, spec), [means, rotations, scales, cam_from_world]| {
            let mask = Geometry { means, rotations, scales, cam_from_world, ..Geometry::default() };
            let found = B::depth_slope_backward(inputs, grad, spec, mask);
            [found.means, found.rotations, found.scales, found.cam_from_world]
        });
    }
}

#[derive(Debug)]
struct RasterizeRaysBackward;

impl<B: RasterizeRaysBackend + SplatBackend> Backward<B, 5> for RasterizeRaysBackward {
    type State = (RayLayerTensors<B>, FloatTensor<B>, RasterizeSpec, IntersectionCell, PartsCell);

    fn backward(self, ops: Ops<Self::State, 5>, grads: &mut Gradients, _: &mut Checkpointer) {
        differentiate::<B, _, _>(ops, grads, |(inputs, planes, spec, intersections, parts), mask| {
            // The planes are used only through their parts, whose nodes run before this one.
            let grad = planes_grad::<B>(&parts, &planes, None);
            B::rasterize_rays_backward(inputs, planes, grad, spec, RayLayers::from_array(mask), intersections)
                .into_array()
        });
    }
}

impl<B: RasterizeRaysBackend + SplatBackend, C: CheckpointStrategy> RasterizeRaysBackend for Autodiff<B, C> {
    fn depth_slope(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::depth_slope(inner.clone(), spec);
        let Geometry { means, rotations, scales, cam_from_world, .. } = &inputs;
        tracked(DepthSlopeBackward, [means, rotations, scales, cam_from_world], (inner, spec), output)
    }

    fn bounds(projected: FloatTensor<Self>, depth_slope: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self> {
        FloatTensor::<Self>::new(B::bounds(projected.into_primitive(), depth_slope.into_primitive(), spec))
    }

    fn rasterize_rays(
        inputs: RayLayerTensors<Self>,
        intersection_counts: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        parts: PartsCell,
    ) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::rasterize_rays(inner.clone(), intersection_counts, spec, intersections.clone(), parts.clone());
        let state = (inner, output.clone(), spec, intersections, parts);
        tracked(RasterizeRaysBackward, inputs.each_ref().into_array(), state, output)
    }

    // Backward passes are not themselves differentiable: on this backend they take constants.

    fn depth_slope_backward(
        inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        B::depth_slope_backward(inputs, grad.into_primitive(), spec, mask).map(OptionalTensor::constant)
    }

    fn rasterize_rays_backward(
        inputs: RayLayerTensors<Self>,
        planes: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: RasterizeSpec,
        mask: RayLayers<bool>,
        intersections: IntersectionCell,
    ) -> RayLayerGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        let (planes, grad) = (planes.into_primitive(), grad.into_primitive());
        B::rasterize_rays_backward(inputs, planes, grad, spec, mask, intersections).map(OptionalTensor::constant)
    }
}
