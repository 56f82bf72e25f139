//! The backward nodes of the stages. Each stage is one node; a backward pass computes what is tracked.

use std::ops::Range;
use std::sync::PoisonError;

use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, TensorMetadata};
use burn::tensor::Shape;

use crate::blend::{BlendGrads, BlendInputs, BlendNeeds, BlendSpec, PartsCell, TraceCell};
use crate::op::{Slot, SplatBackend};
use crate::project::{ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::shade::{ShadeGrads, ShadeInputs, ShadeNeeds};
use crate::tile::HitCell;

/// Hands a gradient to the parent that wants it.
pub(super) fn register<B: SplatBackend>(grads: &mut Gradients, parent: Option<NodeId>, slot: Slot<B>) {
    if let (Some(parent), Slot::Have(grad)) = (parent, slot) {
        grads.register::<B>(parent, grad);
    }
}

/// A gradient as a constant of the autodiff backend.
pub(super) fn constant<B: SplatBackend, C: CheckpointStrategy>(slot: Slot<B>) -> Slot<Autodiff<B, C>> {
    match slot {
        Slot::Skip => Slot::Skip,
        Slot::Have(grad) => Slot::Have(FloatTensor::<Autodiff<B, C>>::new(grad)),
    }
}

/// What a slot of the autodiff backend holds, without autodiff.
fn inner_slot<B: SplatBackend, C: CheckpointStrategy>(slot: &Slot<Autodiff<B, C>>) -> Slot<B> {
    match slot {
        Slot::Skip => Slot::Skip,
        Slot::Have(tensor) => Slot::Have(tensor.primitive().clone()),
    }
}

/// The same for all gradients of `project`.
pub(super) fn constants<B: SplatBackend, C: CheckpointStrategy>(
    grads: ProjectGrads<B>,
) -> ProjectGrads<Autodiff<B, C>> {
    ProjectGrads {
        means: constant(grads.means),
        rotations: constant(grads.rotations),
        scales: constant(grads.scales),
        opacities: constant(grads.opacities),
        cam_from_world: constant(grads.cam_from_world),
        mean2d: constant(grads.mean2d),
    }
}

impl<B: Backend, C: CheckpointStrategy> ProjectInputs<Autodiff<B, C>> {
    pub(super) fn inner(&self) -> ProjectInputs<B> {
        ProjectInputs {
            means: self.means.primitive().clone(),
            rotations: self.rotations.primitive().clone(),
            scales: self.scales.primitive().clone(),
            opacities: self.opacities.primitive().clone(),
            cam_from_world: self.cam_from_world.primitive().clone(),
        }
    }
}

impl<B: SplatBackend, C: CheckpointStrategy> ShadeInputs<Autodiff<B, C>> {
    fn inner(&self) -> ShadeInputs<B> {
        ShadeInputs {
            sh: self.sh.primitive().clone(),
            means: self.means.primitive().clone(),
            cam_from_world: self.cam_from_world.primitive().clone(),
        }
    }
}

impl<B: SplatBackend, C: CheckpointStrategy> BlendInputs<Autodiff<B, C>> {
    fn inner(&self) -> BlendInputs<B> {
        BlendInputs {
            projected: self.projected.primitive().clone(),
            features: self.features.primitive().clone(),
            background: self.background.primitive().clone(),
        }
    }
}

#[derive(Debug)]
struct ProjectBackward;

impl<B: SplatBackend> Backward<B, 6> for ProjectBackward {
    type State = (ProjectInputs<B>, ProjectSpec);

    fn backward(self, ops: Ops<Self::State, 6>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let [means, rotations, scales, opacities, cam_from_world, mean2d] = ops.parents.each_ref().map(Option::is_some);
        let needs = ProjectNeeds { means, rotations, scales, opacities, cam_from_world, mean2d };
        let (inputs, spec) = ops.state;
        let out = B::project_backward(inputs, grad, spec, needs);
        let slots = [out.means, out.rotations, out.scales, out.opacities, out.cam_from_world, out.mean2d];
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        parents.into_iter().zip(slots).for_each(|(parent, slot)| register::<B>(grads, parent, slot));
    }
}

#[derive(Debug)]
struct ShadeBackward;

impl<B: SplatBackend> Backward<B, 3> for ShadeBackward {
    type State = (ShadeInputs<B>, Slot<B>, ProjectSpec);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let [sh, means, cam_from_world] = ops.parents.each_ref().map(Option::is_some);
        let (inputs, visible, spec) = ops.state;
        let out = B::shade_backward(inputs, visible, grad, spec, ShadeNeeds { sh, means, cam_from_world });
        let slots = [out.sh, out.means, out.cam_from_world];
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        parents.into_iter().zip(slots).for_each(|(parent, slot)| register::<B>(grads, parent, slot));
    }
}

/// Hands a part's gradient to the node of the planes it is taken from, beside the graph.
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

/// The gradient of the planes from those of the parts that have one: the part's own if that is all of the first `alone`
/// planes, else all planes with zeros where no part is.
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
    assert!(!found.is_empty(), "the planes of `blend` have gradients only through `part`");
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
struct BlendBackward;

impl<B: SplatBackend> Backward<B, 4> for BlendBackward {
    type State = (BlendInputs<B>, FloatTensor<B>, BlendSpec, HitCell, TraceCell, PartsCell);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [projected, features, background, mean2d_abs] = ops.parents.each_ref().map(Option::is_some);
        let needs = BlendNeeds { projected, features, background, mean2d_abs };
        let (inputs, planes, spec, hits, trace, parts) = ops.state;
        let alone = (!spec.options.depth).then(|| inputs.background.shape().num_elements());
        // The planes are seen through their parts alone, whose nodes come before this one.
        let grad = planes_grad::<B>(&parts, &planes, alone);
        let out = B::blend_backward(inputs, planes, grad, spec, needs, hits, trace);
        let slots = [out.projected, out.features, out.background, out.mean2d_abs];
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        parents.into_iter().zip(slots).for_each(|(parent, slot)| register::<B>(grads, parent, slot));
    }
}

impl<B: SplatBackend, C: CheckpointStrategy> SplatBackend for Autodiff<B, C> {
    fn project(inputs: ProjectInputs<Self>, mean2d_probe: FloatTensor<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let inner = inputs.inner();
        let ProjectInputs { means, rotations, scales, opacities, cam_from_world } = inputs;
        let parents = [&means, &rotations, &scales, &opacities, &cam_from_world, &mean2d_probe].map(|t| t.node());
        let output = B::project(inner.clone(), mean2d_probe.primitive().clone(), spec);
        match ProjectBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((inner, spec), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn shade(inputs: ShadeInputs<Self>, visible: Slot<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        // Who is visible changes at borders alone: it has no gradient.
        let (inner, visible) = (inputs.inner(), inner_slot(&visible));
        let parents = [&inputs.sh, &inputs.means, &inputs.cam_from_world].map(|t| t.node());
        let output = B::shade(inner.clone(), visible.clone(), spec);
        match ShadeBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((inner, visible, spec), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn tile(projected: FloatTensor<Self>, spec: BlendSpec, hits: HitCell) -> IntTensor<Self> {
        B::tile(projected.into_primitive(), spec, hits)
    }

    fn blend(
        inputs: BlendInputs<Self>,
        mean2d_abs_probe: FloatTensor<Self>,
        tile_counts: IntTensor<Self>,
        spec: BlendSpec,
        hits: HitCell,
        _: Option<TraceCell>,
        parts: PartsCell,
    ) -> FloatTensor<Self> {
        let inner = inputs.inner();
        let parents = [&inputs.projected, &inputs.features, &inputs.background, &mean2d_abs_probe].map(|t| t.node());
        let probe = mean2d_abs_probe.primitive().clone();
        match BlendBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let trace = TraceCell::default();
                let kept = Some(trace.clone());
                let output = B::blend(inner.clone(), probe, tile_counts, spec, hits.clone(), kept, parts.clone());
                prep.finish((inner, output.clone(), spec, hits, trace, parts), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::blend(inner, probe, tile_counts, spec, hits, None, parts)),
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

    // Backward passes are not differentiable themselves: called on this backend they see constants.

    fn project_backward(
        inputs: ProjectInputs<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ProjectNeeds,
    ) -> ProjectGrads<Self> {
        constants(B::project_backward(inputs.inner(), grad.into_primitive(), spec, needs))
    }

    fn shade_backward(
        inputs: ShadeInputs<Self>,
        visible: Slot<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ShadeNeeds,
    ) -> ShadeGrads<Self> {
        let out = B::shade_backward(inputs.inner(), inner_slot(&visible), grad.into_primitive(), spec, needs);
        ShadeGrads { sh: constant(out.sh), means: constant(out.means), cam_from_world: constant(out.cam_from_world) }
    }

    fn blend_backward(
        inputs: BlendInputs<Self>,
        planes: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: BlendSpec,
        needs: BlendNeeds,
        hits: HitCell,
        trace: TraceCell,
    ) -> BlendGrads<Self> {
        let (planes, grad) = (planes.into_primitive(), grad.into_primitive());
        let out = B::blend_backward(inputs.inner(), planes, grad, spec, needs, hits, trace);
        BlendGrads {
            projected: constant(out.projected),
            features: constant(out.features),
            background: constant(out.background),
            mean2d_abs: constant(out.mean2d_abs),
        }
    }
}
