//! Backward nodes of the stages. Each stage is one node; a backward pass computes only the gradients of tracked inputs.

use std::fmt::{self, Debug, Formatter};
use std::sync::PoisonError;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::{CheckpointStrategy, NoCheckpointing};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, TensorMetadata};
use burn::tensor::Slice;

use super::stages::SplatBackend;
use super::tensors::{
    GeometryGrads, GeometryTensors, InputTensor, LayerGrads, LayerTensors, OptionalTensor, PlaneGrads, RayLayerGrads,
    RayLayerTensors, ShadingGrads, ShadingTensors,
};
use crate::intersect::IntersectionCell;
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::{Layers, PartsCell, PlaneParts, RasterizeSpec, TraceCell};
use crate::rasterize_rays::RayLayers;
use crate::sh::Shading;

/// A tensor of any [`Autodiff`] over `B`.
type AutodiffTensor<B> = FloatTensor<Autodiff<B>>;

/// The backward pass of an operation with `N` inputs. As a trait object: Burn's graph is then compiled once for each backend and number
/// of inputs instead of once for each operation.
trait Pass<B: Backend, const N: usize>: Send {
    /// Returns the gradients of the inputs that `mask` selects. `grad` takes that of the output.
    fn run(self: Box<Self>, grad: &mut dyn FnMut() -> FloatTensor<B>, mask: [bool; N]) -> [OptionalTensor<B>; N];

    fn copy(&self) -> Box<dyn Pass<B, N>>;
}

/// A pass by the gradient of the output.
#[derive(Clone)]
struct ByGrad<F>(F);

impl<B: Backend, F, const N: usize> Pass<B, N> for ByGrad<F>
where
    F: FnOnce(FloatTensor<B>, [bool; N]) -> [OptionalTensor<B>; N] + Clone + Send + 'static,
{
    fn run(self: Box<Self>, grad: &mut dyn FnMut() -> FloatTensor<B>, mask: [bool; N]) -> [OptionalTensor<B>; N] {
        self.0(grad(), mask)
    }

    fn copy(&self) -> Box<dyn Pass<B, N>> {
        Box::new(self.clone())
    }
}

/// A pass whose gradients arrive outside the graph.
#[derive(Clone)]
struct ByParts<F>(F);

impl<B: Backend, F, const N: usize> Pass<B, N> for ByParts<F>
where
    F: FnOnce([bool; N]) -> [OptionalTensor<B>; N] + Clone + Send + 'static,
{
    fn run(self: Box<Self>, _: &mut dyn FnMut() -> FloatTensor<B>, mask: [bool; N]) -> [OptionalTensor<B>; N] {
        self.0(mask)
    }

    fn copy(&self) -> Box<dyn Pass<B, N>> {
        Box::new(self.clone())
    }
}

/// State of a [`Node`].
struct BackwardPass<B: Backend, const N: usize>(Box<dyn Pass<B, N>>);

impl<B: Backend, const N: usize> Clone for BackwardPass<B, N> {
    fn clone(&self) -> Self {
        Self(self.0.copy())
    }
}

impl<B: Backend, const N: usize> Debug for BackwardPass<B, N> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str("BackwardPass")
    }
}

/// The backward node of every operation.
#[derive(Debug)]
struct Node;

impl<B: Backend, const N: usize> Backward<B, N> for Node {
    type State = BackwardPass<B, N>;

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let mask = ops.parents.each_ref().map(Option::is_some);
        let found = ops.state.0.run(&mut || grads.consume::<B>(&ops.node), mask);
        for (parent, found) in ops.parents.into_iter().zip(found) {
            if let (Some(parent), OptionalTensor::Present(grad)) = (parent, found) {
                grads.register::<B>(parent.id, grad);
            }
        }
    }
}

/// An operation before its output is known. Its inputs are not computed again, whatever the strategy of checkpoints.
type Prepared<B, const N: usize> = OpsKind<Node, B, BackwardPass<B, N>, NoCheckpointing, N>;

fn prepared<B: Backend, const N: usize>(inputs: [&AutodiffTensor<B>; N]) -> Prepared<B, N> {
    Node.prepare::<NoCheckpointing>(inputs.map(|input| input.node())).compute_bound().stateful()
}

/// Returns the output of an operation, with `pass` as its backward pass if any input is tracked: a function from the gradient of the
/// output and a mask of the inputs that need one to their gradients.
pub(super) fn tracked<B: Backend, F, const N: usize>(
    inputs: [&AutodiffTensor<B>; N],
    output: FloatTensor<B>,
    pass: F,
) -> AutodiffTensor<B>
where
    F: FnOnce(FloatTensor<B>, [bool; N]) -> [OptionalTensor<B>; N] + Clone + Send + 'static,
{
    finished(prepared(inputs), output, Box::new(ByGrad(pass)))
}

fn finished<B: Backend, const N: usize>(
    prepared: Prepared<B, N>,
    output: FloatTensor<B>,
    pass: Box<dyn Pass<B, N>>,
) -> AutodiffTensor<B> {
    match prepared {
        OpsKind::Tracked(prep) => prep.finish(BackwardPass(pass), output),
        OpsKind::UnTracked(prep) => prep.finish(output),
    }
}

/// Returns the gradients of the planes of a render of `features` features from those of the ranges that were taken of them.
fn plane_grads<B: SplatBackend>(parts: &PartsCell, features: usize) -> PlaneGrads<B> {
    let own = PlaneParts { colour: 0..features, alpha: features..features + 1, depth: features + 1..features + 2 };
    let mut found = PlaneParts::<Option<FloatTensor<B>>>::default();
    for (range, grad) in parts.0.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
        let grad = *grad.downcast::<FloatTensor<B>>().expect("parts are of the planes' backend");
        let [_, height, width] = grad.shape().dims();
        for (sum, own) in found.each_mut().zip(own.clone()).into_array() {
            // A range has the whole of a part or nothing of it.
            if range.start > own.start || range.end < own.end {
                continue;
            }
            let planes = own.start - range.start..own.end - range.start;
            let share = match range == own {
                true => grad.clone(),
                false => B::float_slice(grad.clone(), &[planes, 0..height, 0..width].map(Slice::from)),
            };
            *sum = Some(match sum.take() {
                Some(sum) => B::float_add(sum, share),
                None => share,
            });
        }
    }
    found.map(OptionalTensor::from)
}

impl<B: SplatBackend, C: CheckpointStrategy> SplatBackend for Autodiff<B, C> {
    fn project(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::project(inner.clone(), spec);
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            B::project_backward(inner, grad, spec, Geometry::from_array(mask)).into_array()
        })
    }

    fn evaluate_sh(
        inputs: ShadingTensors<Self>,
        visible: OptionalTensor<Self>,
        spec: ProjectSpec,
    ) -> FloatTensor<Self> {
        // The set of visible Gaussians is piecewise constant, so `visible` has no gradient.
        let (inner, visible) = (inputs.each_ref().map(InputTensor::inner), visible.inner());
        let output = B::evaluate_sh(inner.clone(), visible.clone(), spec);
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            B::sh_backward(inner, visible, grad, spec, Shading::from_array(mask)).into_array()
        })
    }

    fn intersect(
        projected: FloatTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
    ) -> IntTensor<Self> {
        B::intersect(projected.into_primitive(), spec, intersections)
    }

    fn rasterize(
        inputs: LayerTensors<Self>,
        intersection_counts: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        _: Option<TraceCell>,
        parts: PartsCell,
    ) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let prepared = prepared(inputs.each_ref().map(|input| &input.0).into_array());
        // The trace is kept only where a backward pass is possible.
        let trace = matches!(prepared, OpsKind::Tracked(_)).then(TraceCell::default);
        let (cell, kept) = (intersections.clone(), trace.clone());
        let output = B::rasterize(inner.clone(), intersection_counts, spec, cell, kept, parts.clone());
        let planes = output.clone();
        let pass = move |mask| {
            // The planes are used only through their parts, whose nodes run before this one.
            let grads = plane_grads::<B>(&parts, inner.background.0.shape().num_elements());
            let (mask, trace) = (Layers::from_array(mask), trace.unwrap_or_default());
            B::rasterize_backward(inner, planes, grads, spec, mask, intersections, trace).into_array()
        };
        finished(prepared, output, Box::new(ByParts(pass)))
    }

    fn part(planes: FloatTensor<Self>, from: usize, to: usize, parts: PartsCell) -> FloatTensor<Self> {
        let output = B::part(planes.primitive().clone(), from, to, parts.clone());
        // The gradient goes to the node of the planes outside the graph.
        tracked([&planes], output, move |grad, _| {
            parts.0.lock().unwrap_or_else(PoisonError::into_inner).push((from..to, Box::new(grad)));
            [OptionalTensor::Absent]
        })
    }

    fn ray_space(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::ray_space(inner.clone(), spec);
        let Geometry { means, rotations, scales, cam_from_world, mean2d, .. } = inputs.each_ref().map(|input| &input.0);
        let tracked_inputs = [means, rotations, scales, cam_from_world, mean2d];
        tracked(tracked_inputs, output, move |grad, [means, rotations, scales, cam_from_world, mean2d]| {
            let mask = Geometry { means, rotations, scales, cam_from_world, mean2d, ..Geometry::default() };
            let found = B::ray_space_backward(inner, grad, spec, mask);
            [found.means, found.rotations, found.scales, found.cam_from_world, found.mean2d]
        })
    }

    fn bounds(projected: FloatTensor<Self>, ray_space: FloatTensor<Self>, spec: RasterizeSpec) -> FloatTensor<Self> {
        FloatTensor::<Self>::new(B::bounds(projected.into_primitive(), ray_space.into_primitive(), spec))
    }

    fn rasterize_rays(
        inputs: RayLayerTensors<Self>,
        counts: IntTensor<Self>,
        spec: RasterizeSpec,
        intersections: IntersectionCell,
        _: Option<TraceCell>,
        parts: PartsCell,
    ) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let prepared = prepared(inputs.each_ref().map(|input| &input.0).into_array());
        // As in `rasterize`.
        let trace = matches!(prepared, OpsKind::Tracked(_)).then(TraceCell::default);
        let (cell, kept) = (intersections.clone(), trace.clone());
        let output = B::rasterize_rays(inner.clone(), counts, spec, cell, kept, parts.clone());
        let planes = output.clone();
        let pass = move |mask| {
            let grads = plane_grads::<B>(&parts, inner.background.0.shape().num_elements());
            let (mask, trace) = (RayLayers::from_array(mask), trace.unwrap_or_default());
            B::rasterize_rays_backward(inner, planes, grads, spec, mask, intersections, trace).into_array()
        };
        finished(prepared, output, Box::new(ByParts(pass)))
    }

    // Backward passes are not themselves differentiable: on this backend they take constants.

    fn project_backward(
        inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        B::project_backward(inputs, grad.into_primitive(), spec, mask).map(OptionalTensor::constant)
    }

    fn sh_backward(
        inputs: ShadingTensors<Self>,
        visible: OptionalTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Shading<bool>,
    ) -> ShadingGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        B::sh_backward(inputs, visible.inner(), grad.into_primitive(), spec, mask).map(OptionalTensor::constant)
    }

    fn rasterize_backward(
        inputs: LayerTensors<Self>,
        planes: FloatTensor<Self>,
        grads: PlaneGrads<Self>,
        spec: RasterizeSpec,
        mask: Layers<bool>,
        intersections: IntersectionCell,
        trace: TraceCell,
    ) -> LayerGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        let (planes, grads) = (planes.into_primitive(), grads.map(OptionalTensor::inner));
        B::rasterize_backward(inputs, planes, grads, spec, mask, intersections, trace).map(OptionalTensor::constant)
    }

    fn ray_space_backward(
        inputs: GeometryTensors<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        mask: Geometry<bool>,
    ) -> GeometryGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        B::ray_space_backward(inputs, grad.into_primitive(), spec, mask).map(OptionalTensor::constant)
    }

    fn rasterize_rays_backward(
        inputs: RayLayerTensors<Self>,
        planes: FloatTensor<Self>,
        grads: PlaneGrads<Self>,
        spec: RasterizeSpec,
        mask: RayLayers<bool>,
        intersections: IntersectionCell,
        trace: TraceCell,
    ) -> RayLayerGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        let (planes, grads) = (planes.into_primitive(), grads.map(OptionalTensor::inner));
        B::rasterize_rays_backward(inputs, planes, grads, spec, mask, intersections, trace)
            .map(OptionalTensor::constant)
    }
}
