//! The backward nodes of the stages. Each stage is one node, `project_shade` two; a backward pass computes what is tracked.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, TensorMetadata};
use burn::tensor::{Shape, Slice};

use crate::blend::{BlendGrads, BlendInputs, BlendNeeds, BlendSpec, PartsCell, TraceCell};
use crate::op::{Slot, SplatBackend};
use crate::project::{ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::project_shade::{ProjectShadeGrads, ProjectShadeInputs, ProjectShadeNeeds, ProjectedColours};
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

impl<B: SplatBackend, C: CheckpointStrategy> ProjectShadeInputs<Autodiff<B, C>> {
    fn inner(&self) -> ProjectShadeInputs<B> {
        ProjectShadeInputs {
            geometry: self.geometry.inner(),
            sh: self.sh.primitive().clone(),
            matte: inner_slot(&self.matte),
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
    type State = ShadeInputs<B>;

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let [sh, means, cam_from_world] = ops.parents.each_ref().map(Option::is_some);
        let out = B::shade_backward(ops.state, grad, ShadeNeeds { sh, means, cam_from_world });
        let slots = [out.sh, out.means, out.cam_from_world];
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        parents.into_iter().zip(slots).for_each(|(parent, slot)| register::<B>(grads, parent, slot));
    }
}

/// The gradient of the colours, on its way to the node of the ellipses that both come from.
type ColourGrad<B> = Arc<Mutex<Option<FloatTensor<B>>>>;

/// Hands the colours' gradient to the node of the ellipses, beside the graph: a node has one output.
#[derive(Debug)]
struct ColoursBackward;

impl<B: SplatBackend> Backward<B, 1> for ColoursBackward {
    type State = ColourGrad<B>;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        *ops.state.lock().unwrap_or_else(PoisonError::into_inner) = Some(grad);
    }
}

#[derive(Debug)]
struct ProjectShadeBackward;

impl<B: SplatBackend> Backward<B, 7> for ProjectShadeBackward {
    type State = (ProjectShadeInputs<B>, ProjectSpec, ColourGrad<B>);

    fn backward(self, ops: Ops<Self::State, 7>, grads: &mut Gradients, _: &mut Checkpointer) {
        let packed = grads.consume::<B>(&ops.node);
        let [means, rotations, scales, opacities, sh, mean2d, matte] = ops.parents.each_ref().map(Option::is_some);
        let geometry = ProjectNeeds { means, rotations, scales, opacities, cam_from_world: false, mean2d };
        let (inputs, spec, colours) = ops.state;
        let colours = colours.lock().unwrap_or_else(PoisonError::into_inner).take();
        let colours = colours.expect("`blend`, which alone is given both outputs, has a gradient for both or for none");
        let grad = ProjectedColours { packed, colours };
        let out = B::project_shade_backward(inputs, grad, spec, ProjectShadeNeeds { geometry, sh, matte });
        let g = out.geometry;
        let slots = [g.means, g.rotations, g.scales, g.opacities, out.sh, g.mean2d, out.matte];
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

/// `[N, 3]`: colours by `shade` alone, of the first rows and of the matte ones after them.
fn shade_groups<B: SplatBackend>(
    sh: FloatTensor<B>,
    matte: Slot<B>,
    means: &FloatTensor<B>,
    cam_from_world: &FloatTensor<B>,
) -> FloatTensor<B> {
    let shade = |sh, means| B::shade(ShadeInputs { sh, means, cam_from_world: cam_from_world.clone() });
    let Slot::Have(matte) = matte else { return shade(sh, means.clone()) };
    let (count, first) = (means.shape()[0], sh.shape()[0]);
    let rows = |range: Range<usize>| B::float_slice(means.clone(), &[range, 0..3].map(Slice::from));
    B::float_cat(vec![shade(sh, rows(0..first)), shade(matte, rows(first..count))], 0)
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

    fn shade(inputs: ShadeInputs<Self>) -> FloatTensor<Self> {
        let inner = inputs.inner();
        let parents = [&inputs.sh, &inputs.means, &inputs.cam_from_world].map(|t| t.node());
        let output = B::shade(inner.clone());
        match ShadeBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(inner, output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn project_shade(
        inputs: ProjectShadeInputs<Self>,
        mean2d_probe: FloatTensor<Self>,
        spec: ProjectSpec,
    ) -> ProjectedColours<Self> {
        let ProjectInputs { means, rotations, scales, opacities, cam_from_world } = &inputs.geometry;
        let geometry = [means, rotations, scales, opacities, &mean2d_probe].iter().any(|input| input.is_tracked());
        // One node would compute gradients that nobody asked for; and that of the pose it does not know.
        let harmonics = inputs.sh.is_tracked() || inputs.matte.as_ref().is_some_and(|matte| matte.is_tracked());
        if cam_from_world.is_tracked() || geometry != harmonics {
            let colours = shade_groups::<Self>(inputs.sh, inputs.matte, means, cam_from_world);
            return ProjectedColours { packed: Self::project(inputs.geometry, mean2d_probe, spec), colours };
        }
        let inner = inputs.inner();
        // Where there is nothing matte, the pose stands in for it, which is not tracked here.
        let matte = inputs.matte.as_ref().unwrap_or(cam_from_world);
        let parents = [means, rotations, scales, opacities, &inputs.sh, &mean2d_probe, matte].map(|input| input.node());
        let out = B::project_shade(inner.clone(), mean2d_probe.primitive().clone(), spec);
        let grad = ColourGrad::<B>::default();
        let packed = match ProjectShadeBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((inner, spec, grad.clone()), out.packed),
            OpsKind::UnTracked(prep) => prep.finish(out.packed),
        };
        let colours = match ColoursBackward.prepare::<C>([packed.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(grad, out.colours),
            OpsKind::UnTracked(prep) => prep.finish(out.colours),
        };
        ProjectedColours { packed, colours }
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

    fn project_shade_backward(
        inputs: ProjectShadeInputs<Self>,
        grad: ProjectedColours<Self>,
        spec: ProjectSpec,
        needs: ProjectShadeNeeds,
    ) -> ProjectShadeGrads<Self> {
        let ProjectedColours { packed, colours } = grad;
        let grad = ProjectedColours { packed: packed.into_primitive(), colours: colours.into_primitive() };
        let out = B::project_shade_backward(inputs.inner(), grad, spec, needs);
        ProjectShadeGrads { geometry: constants(out.geometry), sh: constant(out.sh), matte: constant(out.matte) }
    }

    fn shade_backward(inputs: ShadeInputs<Self>, grad: FloatTensor<Self>, needs: ShadeNeeds) -> ShadeGrads<Self> {
        let out = B::shade_backward(inputs.inner(), grad.into_primitive(), needs);
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
