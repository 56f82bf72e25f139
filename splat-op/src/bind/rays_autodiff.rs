//! The backward nodes of `tilt` and `rays`.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::{FloatTensor, IntTensor};

use super::autodiff::{constant, constants, planes_grad, register};
use super::rays::RaysBackend;
use crate::blend::{BlendSpec, PartsCell};
use crate::op::SplatBackend;
use crate::project::{ProjectGrads, ProjectInputs, ProjectNeeds, ProjectSpec};
use crate::rays::{RaysGrads, RaysInputs, RaysNeeds};
use crate::tile::HitCell;

impl<B: RaysBackend, C: CheckpointStrategy> RaysInputs<Autodiff<B, C>> {
    fn inner(&self) -> RaysInputs<B> {
        RaysInputs {
            projected: self.projected.primitive().clone(),
            tilt: self.tilt.primitive().clone(),
            features: self.features.primitive().clone(),
            background: self.background.primitive().clone(),
        }
    }
}

#[derive(Debug)]
struct TiltBackward;

impl<B: RaysBackend + SplatBackend> Backward<B, 4> for TiltBackward {
    type State = (ProjectInputs<B>, ProjectSpec);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let [means, rotations, scales, cam_from_world] = ops.parents.each_ref().map(Option::is_some);
        let needs = ProjectNeeds { means, rotations, scales, opacities: false, cam_from_world, mean2d: false };
        let (inputs, spec) = ops.state;
        let out = B::tilt_backward(inputs, grad, spec, needs);
        let slots = [out.means, out.rotations, out.scales, out.cam_from_world];
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        parents.into_iter().zip(slots).for_each(|(parent, slot)| register::<B>(grads, parent, slot));
    }
}

#[derive(Debug)]
struct RaysBackward;

impl<B: RaysBackend + SplatBackend> Backward<B, 5> for RaysBackward {
    type State = (RaysInputs<B>, FloatTensor<B>, BlendSpec, HitCell, PartsCell);

    fn backward(self, ops: Ops<Self::State, 5>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [projected, tilt, features, background, mean2d_abs] = ops.parents.each_ref().map(Option::is_some);
        let needs = RaysNeeds { projected, tilt, features, background, mean2d_abs };
        let (inputs, planes, spec, hits, parts) = ops.state;
        // The planes are seen through their parts alone, whose nodes come before this one.
        let grad = planes_grad::<B>(&parts, &planes, None);
        let out = B::rays_backward(inputs, planes, grad, spec, needs, hits);
        let slots = [out.projected, out.tilt, out.features, out.background, out.mean2d_abs];
        let parents = ops.parents.map(|parent| parent.map(|node| node.id));
        parents.into_iter().zip(slots).for_each(|(parent, slot)| register::<B>(grads, parent, slot));
    }
}

impl<B: RaysBackend + SplatBackend, C: CheckpointStrategy> RaysBackend for Autodiff<B, C> {
    fn tilt(inputs: ProjectInputs<Self>, spec: ProjectSpec) -> FloatTensor<Self> {
        let inner = inputs.inner();
        let ProjectInputs { means, rotations, scales, cam_from_world, .. } = inputs;
        let parents = [&means, &rotations, &scales, &cam_from_world].map(|t| t.node());
        let output = B::tilt(inner.clone(), spec);
        match TiltBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((inner, spec), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn outline(projected: FloatTensor<Self>, tilt: FloatTensor<Self>, spec: BlendSpec) -> FloatTensor<Self> {
        FloatTensor::<Self>::new(B::outline(projected.into_primitive(), tilt.into_primitive(), spec))
    }

    fn rays(
        inputs: RaysInputs<Self>,
        mean2d_abs_probe: FloatTensor<Self>,
        tile_counts: IntTensor<Self>,
        spec: BlendSpec,
        hits: HitCell,
        parts: PartsCell,
    ) -> FloatTensor<Self> {
        let inner = inputs.inner();
        let RaysInputs { projected, tilt, features, background } = inputs;
        let parents = [&projected, &tilt, &features, &background, &mean2d_abs_probe].map(|t| t.node());
        let probe = mean2d_abs_probe.primitive().clone();
        let output = B::rays(inner.clone(), probe, tile_counts, spec, hits.clone(), parts.clone());
        match RaysBackward.prepare::<C>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((inner, output.clone(), spec, hits, parts), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    // Backward passes are not differentiable themselves: called on this backend they see constants.

    fn tilt_backward(
        inputs: ProjectInputs<Self>,
        grad: FloatTensor<Self>,
        spec: ProjectSpec,
        needs: ProjectNeeds,
    ) -> ProjectGrads<Self> {
        constants(B::tilt_backward(inputs.inner(), grad.into_primitive(), spec, needs))
    }

    fn rays_backward(
        inputs: RaysInputs<Self>,
        planes: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: BlendSpec,
        needs: RaysNeeds,
        hits: HitCell,
    ) -> RaysGrads<Self> {
        let out = B::rays_backward(inputs.inner(), planes.into_primitive(), grad.into_primitive(), spec, needs, hits);
        RaysGrads {
            projected: constant(out.projected),
            tilt: constant(out.tilt),
            features: constant(out.features),
            background: constant(out.background),
            mean2d_abs: constant(out.mean2d_abs),
        }
    }
}
