//! The backward nodes of the stages. Each stage is one node; its backward pass computes what is tracked.

use burn::backend::Autodiff;
use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::{FloatTensor, IntTensor};

use crate::blend::{BlendGrads, BlendInputs, BlendNeeds, BlendSpec, TraceCell};
use crate::op::{Slot, SplatBackend};
use crate::project::{ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::shade::{ShadeGrads, ShadeInputs, ShadeNeeds};
use crate::tile::HitCell;

/// Hands a gradient to the parent that wants it.
fn register<B: SplatBackend>(grads: &mut Gradients, parent: Option<NodeId>, slot: Slot<B>) {
    if let (Some(parent), Slot::Have(grad)) = (parent, slot) {
        grads.register::<B>(parent, grad);
    }
}

/// A gradient as a constant of the autodiff backend.
fn constant<B: SplatBackend, C: CheckpointStrategy>(slot: Slot<B>) -> Slot<Autodiff<B, C>> {
    match slot {
        Slot::Skip => Slot::Skip,
        Slot::Have(grad) => Slot::Have(FloatTensor::<Autodiff<B, C>>::new(grad)),
    }
}

impl<B: SplatBackend, C: CheckpointStrategy> ProjectInputs<Autodiff<B, C>> {
    fn inner(&self) -> ProjectInputs<B> {
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

#[derive(Debug)]
struct BlendBackward;

impl<B: SplatBackend> Backward<B, 4> for BlendBackward {
    type State = (BlendInputs<B>, FloatTensor<B>, BlendSpec, HitCell, TraceCell);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let [projected, features, background, mean2d_abs] = ops.parents.each_ref().map(Option::is_some);
        let needs = BlendNeeds { projected, features, background, mean2d_abs };
        let (inputs, planes, spec, hits, trace) = ops.state;
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

    fn shade(inputs: ShadeInputs<Self>) -> FloatTensor<Self> {
        let inner = inputs.inner();
        let parents = [&inputs.sh, &inputs.means, &inputs.cam_from_world].map(|t| t.node());
        let output = B::shade(inner.clone());
        match ShadeBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(inner, output),
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
    ) -> FloatTensor<Self> {
        let inner = inputs.inner();
        let parents = [&inputs.projected, &inputs.features, &inputs.background, &mean2d_abs_probe].map(|t| t.node());
        let probe = mean2d_abs_probe.primitive().clone();
        match BlendBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let trace = TraceCell::default();
                let output = B::blend(inner.clone(), probe, tile_counts, spec, hits.clone(), Some(trace.clone()));
                prep.finish((inner, output.clone(), spec, hits, trace), output)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::blend(inner, probe, tile_counts, spec, hits, None)),
        }
    }

    // Backward passes are not differentiable themselves: called on this backend they see constants.

    fn project_backward(
        inputs: ProjectInputs<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ProjectNeeds,
    ) -> ProjectGrads<Self> {
        let out = B::project_backward(inputs.inner(), grad.into_primitive(), spec, needs);
        ProjectGrads {
            means: constant(out.means),
            rotations: constant(out.rotations),
            scales: constant(out.scales),
            opacities: constant(out.opacities),
            cam_from_world: constant(out.cam_from_world),
            mean2d: constant(out.mean2d),
        }
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
