//! Adam's step on a scene.

use burn::module::{Param, ParamId};
use burn::tensor::{DType, Device, Int, Shape, Tensor};
use splat_op::adam::{GroupStep, Stepped, has_kernel, step_groups};

use super::{Gradients, Trained};
use crate::gaussians::{BASE_GROUPS, Group, GroupOptions, SH};
use crate::optim::moments::{Moments, Stored};
use crate::optim::{Adam, LearningRates, MomentBits, Rates};

/// Learning rates of one step.
#[derive(Clone, Copy, Debug)]
pub struct StepRates {
    /// Rates of the parameters of every scene other than the centres.
    pub rates: LearningRates,
    /// Rate of the centres, scene units.
    pub means: f64,
    /// Share of the run that is done, 0 to 1. Rates of further groups fall with it.
    pub done: f64,
    /// Photographs of the step. Rates of further groups grow with the root of it (see [`LearningRates::for_batch`]).
    pub views: usize,
}

impl StepRates {
    fn of(&self, group: &Group) -> Rates {
        let LearningRates { scales, rotations, sh_dc, sh_rest, opacities, .. } = self.rates;
        match BASE_GROUPS.iter().position(|own| *own == group.name()) {
            Some(SH) => Rates { first: sh_dc, others: sh_rest, width: 3 },
            Some(own) => [self.means, rotations, scales, opacities][own].into(),
            None => {
                let GroupOptions { rate, final_share, .. } = *group.options();
                (rate * final_share.powf(self.done) * (self.views as f64).sqrt()).into()
            }
        }
    }
}

impl Trained {
    /// Takes one Adam step on every parameter that has a gradient. `step` counts from 1. With a verdict, `[2]` (see
    /// [`splat_op::adam`]), the device leaves everything unchanged if a step is recorded in it.
    ///
    /// # Panics
    /// If a gradient has not the shape of its block.
    pub fn step(
        &mut self,
        mut gradients: Gradients,
        adam: &Adam,
        rates: &StepRates,
        step: usize,
        verdict: Option<&Tensor<1, Int>>,
    ) {
        let first = self.gaussians.sh_id();
        let coefficients = self.mark.take().filter(|(id, _)| *id == first).map(|(_, mark)| mark);
        let groups = self.gaussians.groups.iter_mut().zip(&mut self.moments).enumerate();
        // One operation takes all steps where it can.
        let (mut together, mut places, mut marked, mut tracked) = (Vec::new(), Vec::new(), None, None);
        for (place, (group, moments)) in groups {
            let rate = rates.of(group);
            let found = gradients.0.iter().position(|found| found.name == group.name());
            let Some(gradients) = found.map(|found| gradients.0.swap_remove(found)) else { continue };
            if place >= BASE_GROUPS.len() && rate.others == 0.0 {
                continue;
            }
            let shapes = group.blocks.iter().map(|block| block.val().dims());
            let fits = shapes.zip(&gradients.blocks).all(|(dims, grad)| grad.as_ref().is_none_or(|g| g.dims() == dims));
            assert!(
                fits && gradients.blocks.len() == group.blocks.len(),
                "gradients of `{}` have not the shape of its blocks",
                gradients.name
            );
            for (block, gradient) in gradients.blocks.into_iter().enumerate() {
                let Some(grad) = gradient else { continue };
                let (param, moments) = (&mut group.blocks[block], &mut moments[block]);
                let device = param.val().device();
                if !has_kernel(&grad) || moments.bits() != MomentBits::ThirtyTwo {
                    let values = adam.step_unless(take(param), grad, rate, moments, step, verdict);
                    *param = Param::from_tensor(on(&device, values));
                    continue;
                }
                tracked = Some(device);
                if (place, block) == (SH, 0) {
                    marked = Some(together.len());
                }
                let Stored::Full { m, v } = moments.take() else { unreachable!("moments of 32 bits are full") };
                let from = Stepped { param: take(param), m, v };
                together.push(GroupStep { from, grad, factors: adam.factors(rate, step) });
                places.push((place, block));
            }
        }
        let Some(device) = tracked.filter(|_| !together.is_empty()) else { return };
        let mark = marked.map(|at| {
            let none = || Tensor::zeros([1], (&device.clone().inner(), DType::I32));
            (at, coefficients.unwrap_or_else(none))
        });
        let (stepped, mark) = step_groups(together, verdict, mark);
        for ((place, block), Stepped { param, m, v }) in places.into_iter().zip(stepped) {
            self.gaussians.groups[place].blocks[block] = Param::from_tensor(on(&device, param));
            self.moments[place][block] = Moments::full(m, v);
        }
        self.mark = mark.map(|mark| (self.gaussians.sh_id(), mark));
    }
}

/// `values` on the device of a parameter, tracked if that is an autodiff device.
pub(super) fn on<const D: usize>(device: &Device, values: Tensor<D>) -> Tensor<D> {
    if device.is_autodiff() { Tensor::from_inner(values) } else { values }
}

pub(super) fn replace<const D: usize>(param: &mut Param<Tensor<D>>, values: Tensor<D>) {
    let device = param.val().device();
    *param = Param::from_tensor(on(&device, values));
}

/// Moves the values out of a parameter, so that no other reference exists. Nothing is allocated for the parameter that stays.
pub(super) fn take<const D: usize>(param: &mut Param<Tensor<D>>) -> Tensor<D> {
    let device = param.val().device();
    let none = |device: &Device, _: bool| Tensor::empty([0; D], device);
    let none = Param::uninitialized(ParamId::new(), none, device, false, Shape::from([0; D]));
    std::mem::replace(param, none).into_value().inner()
}
