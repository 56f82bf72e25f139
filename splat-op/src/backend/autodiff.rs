//! Backward nodes of the stages. Each stage is one node; a backward pass computes only the gradients of tracked inputs.

use std::ops::Range;
use std::sync::PoisonError;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, TensorMetadata};
use burn::tensor::Shape;

use super::stages::SplatBackend;
use super::tensors::{
    GeometryGrads, GeometryTensors, InputTensor, LayerGrads, LayerTensors, OptionalTensor, ShadingGrads, ShadingTensors,
};
use crate::intersect::IntersectionCell;
use crate::project::{Geometry, ProjectSpec};
use crate::rasterize::{Layers, PartsCell, RasterizeSpec, TraceCell};
use crate::sh::Shading;

/// Returns the output of a stage, with `kind` as its backward node if any input is tracked.
pub(super) fn tracked<B: Backend, C: CheckpointStrategy, K: Backward<B, N>, const N: usize>(
    kind: K,
    inputs: [&InputTensor<Autodiff<B, C>>; N],
    state: K::State,
    output: FloatTensor<B>,
) -> FloatTensor<Autodiff<B, C>> {
    match kind.prepare::<C>(inputs.map(|input| input.0.node())).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish(state, output),
        OpsKind::UnTracked(prep) => prep.finish(output),
    }
}

/// Runs a backward pass for the inputs that need a gradient, and registers the gradient of each.
pub(super) fn differentiate<B: Backend, S, const N: usize>(
    ops: Ops<S, N>,
    grads: &mut Gradients,
    backward: impl FnOnce(S, [bool; N]) -> [OptionalTensor<B>; N],
) {
    let mask = ops.parents.each_ref().map(Option::is_some);
    for (parent, found) in ops.parents.into_iter().zip(backward(ops.state, mask)) {
        if let (Some(parent), OptionalTensor::Present(grad)) = (parent, found) {
            grads.register::<B>(parent.id, grad);
        }
    }
}

#[derive(Debug)]
struct ProjectBackward;

impl<B: SplatBackend> Backward<B, 6> for ProjectBackward {
    type State = (GeometryTensors<B>, ProjectSpec);

    fn backward(self, ops: Ops<Self::State, 6>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        differentiate::<B, _, _>(ops, grads, |(inputs, spec), mask| {
            B::project_backward(inputs, grad, spec, Geometry::from_array(mask)).into_array()
        });
    }
}

#[derive(Debug)]
struct ShBackward;

impl<B: SplatBackend> Backward<B, 3> for ShBackward {
    type State = (ShadingTensors<B>, OptionalTensor<B>, ProjectSpec);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        differentiate::<B, _, _>(ops, grads, |(inputs, visible, spec), mask| {
            B::sh_backward(inputs, visible, grad, spec, Shading::from_array(mask)).into_array()
        });
    }
}

/// Passes the gradient of a part to the node of its planes, outside the graph.
#[derive(Debug)]
struct PartBackward;

impl<B: SplatBackend> Backward<B, 1> for PartBackward {
    type State = (Range<usize>, PartsCell);

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let (range, parts) = ops.state;
        parts.0.lock().unwrap_or_else(PoisonError::into_inner).push((range, Box::new(grad)));
    }
}

/// Returns the gradient of the planes from the gradients of their parts. If only one part has a gradient and it covers the first
/// `alone` planes, the result is that gradient; otherwise it has all planes, with zeros where no part has a gradient.
pub(super) fn planes_grad<B: SplatBackend>(
    parts: &PartsCell,
    planes: &FloatTensor<B>,
    alone: Option<usize>,
) -> FloatTensor<B> {
    let mut found: Vec<(Range<usize>, FloatTensor<B>)> = Vec::new();
    for (range, grad) in parts.0.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
        let grad = grad.downcast::<FloatTensor<B>>().expect("parts are of the planes' backend");
        match found.iter_mut().find(|(other, _)| *other == range) {
            Some((_, sum)) => *sum = B::float_add(sum.clone(), *grad),
            None => found.push((range, *grad)),
        }
    }
    assert!(!found.is_empty(), "the planes of `rasterize` have gradients only through `part`");
    found.sort_by_key(|(range, _)| range.start);
    if let [(range, grad)] = &found[..]
        && alone.is_some_and(|alone| *range == (0..alone))
    {
        return grad.clone();
    }
    let [count, height, width] = planes.shape().dims();
    let zeros = |len: usize| B::float_zeros(Shape::from([len, height, width]), &planes.device(), planes.dtype().into());
    let mut pieces = Vec::new();
    let mut at = 0;
    for (range, grad) in found {
        if range.start > at {
            pieces.push(zeros(range.start - at));
        }
        at = range.end;
        pieces.push(grad);
    }
    if at < count {
        pieces.push(zeros(count - at));
    }
    if pieces.len() == 1 { pieces.remove(0) } else { B::float_cat(pieces, 0) }
}

#[derive(Debug)]
struct RasterizeBackward;

impl<B: SplatBackend> Backward<B, 4> for RasterizeBackward {
    type State = (LayerTensors<B>, FloatTensor<B>, RasterizeSpec, IntersectionCell, TraceCell, PartsCell);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        differentiate::<B, _, _>(ops, grads, |(inputs, planes, spec, intersections, trace, parts), mask| {
            let alone = (!spec.options.depth).then(|| inputs.background.0.shape().num_elements());
            // The planes are used only through their parts, whose nodes run before this one.
            let grad = planes_grad::<B>(&parts, &planes, alone);
            B::rasterize_backward(inputs, planes, grad, spec, Layers::from_array(mask), intersections, trace)
                .into_array()
        });
    }
}

impl<B: SplatBackend, C: CheckpointStrategy> SplatBackend for Autodiff<B, C> {
    fn project(inputs: GeometryTensors<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::project(inner.clone(), spec);
        tracked(ProjectBackward, inputs.each_ref().into_array(), (inner, spec), output)
    }

    fn evaluate_sh(
        inputs: ShadingTensors<Self>,
        visible: OptionalTensor<Self>,
        spec: ProjectSpec,
    ) -> FloatTensor<Self> {
        // The set of visible Gaussians is piecewise constant, so `visible` has no gradient.
        let (inner, visible) = (inputs.each_ref().map(InputTensor::inner), visible.inner());
        let output = B::evaluate_sh(inner.clone(), visible.clone(), spec);
        tracked(ShBackward, inputs.each_ref().into_array(), (inner, visible, spec), output)
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
        let nodes = inputs.into_array().map(|input| input.0.node());
        // The trace is kept only where a backward pass is possible.
        match RasterizeBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let trace = TraceCell::default();
                let kept = Some(trace.clone());
                let output =
                    B::rasterize(inner.clone(), intersection_counts, spec, intersections.clone(), kept, parts.clone());
                prep.finish((inner, output.clone(), spec, intersections, trace, parts), output)
            }
            OpsKind::UnTracked(prep) => {
                prep.finish(B::rasterize(inner, intersection_counts, spec, intersections, None, parts))
            }
        }
    }

    fn part(planes: FloatTensor<Self>, from: usize, to: usize, parts: PartsCell) -> FloatTensor<Self> {
        let node = planes.node();
        let output = B::part(planes.into_primitive(), from, to, parts.clone());
        match PartBackward.prepare::<C>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((from..to, parts), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
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
        grad: FloatTensor<Self>,
        spec: RasterizeSpec,
        mask: Layers<bool>,
        intersections: IntersectionCell,
        trace: TraceCell,
    ) -> LayerGrads<Self> {
        let inputs = inputs.each_ref().map(InputTensor::inner);
        let (planes, grad) = (planes.into_primitive(), grad.into_primitive());
        B::rasterize_backward(inputs, planes, grad, spec, mask, intersections, trace).map(OptionalTensor::constant)
    }
}
