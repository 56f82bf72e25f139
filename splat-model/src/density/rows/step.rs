//! Adam's step on a scene.

use burn::module::{Param, ParamId};
use burn::tensor::{DType, Device, Int, Shape, Tensor};
use splat_op::RawSplats;
use splat_op::adam::{Factors, Raw, SceneStep, SteppedScene, has_kernel, step_scene};

use super::{Gradients, Trained};
use crate::gaussians::{Gaussians, parameter};
use crate::optim::moments::{Moments, Stored};
use crate::optim::{Adam, LearningRates, MomentBits, Rates};

/// Adam moments of all parameters of a scene.
#[derive(Clone, Debug)]
pub(crate) struct GaussianMoments {
    pub(crate) means: Moments<2>,
    pub(crate) rotations: Moments<2>,
    pub(crate) log_scales: Moments<2>,
    pub(crate) logit_opacities: Moments<1>,
    pub(crate) sh: Moments<3>,
    pub(crate) sh_more: Vec<Moments<3>>,
}

impl GaussianMoments {
    /// Zero moments.
    pub fn new(gaussians: &Gaussians, bits: MomentBits) -> Self {
        Self {
            means: Moments::with_bits(&gaussians.means.val(), bits),
            rotations: Moments::with_bits(&gaussians.rotations.val(), bits),
            log_scales: Moments::with_bits(&gaussians.log_scales.val(), bits),
            logit_opacities: Moments::with_bits(&gaussians.logit_opacities.val(), bits),
            sh: Moments::with_bits(&gaussians.sh.val(), bits),
            sh_more: gaussians.sh_more.iter().map(|block| Moments::with_bits(&block.val(), bits)).collect(),
        }
    }

    pub(super) fn sh_blocks(&self) -> impl Iterator<Item = &Moments<3>> {
        std::iter::once(&self.sh).chain(&self.sh_more)
    }
}

/// Learning rates of one step.
#[derive(Clone, Copy, Debug)]
pub struct StepRates {
    /// Rates of the parameters other than the centres.
    pub rates: LearningRates,
    /// Rate of the centres, scene units.
    pub means: f64,
}

impl Trained {
    /// Takes one Adam step on every parameter that has a gradient. `step` counts from 1. With a verdict, `[2]` (see
    /// [`splat_op::adam`]), the device leaves everything unchanged if a step is recorded in it.
    pub fn step(
        &mut self,
        mut gradients: Gradients,
        adam: &Adam,
        rates: &StepRates,
        step: usize,
        verdict: Option<&Tensor<1, Int>>,
    ) {
        let LearningRates { scales, rotations, sh_dc, sh_rest, opacities, .. } = rates.rates;
        let sh_rates = Rates { first: sh_dc, others: sh_rest };
        let more = self.gaussians.sh_more.iter_mut().zip(&mut self.moments.sh_more);
        for ((block, moments), gradient) in more.zip(gradients.sh_more.drain(..)) {
            update(block, gradient, sh_rates, moments, (adam, step, verdict));
        }
        let gradients = match gradients {
            // One operation takes all steps.
            Gradients {
                means: Some(means),
                rotations: Some(of_rotations),
                log_scales: Some(log_scales),
                logit_opacities: Some(logit_opacities),
                sh: Some(sh),
                ..
            } if has_kernel(&means) && self.moments.means.bits() == MomentBits::ThirtyTwo => {
                let grads = RawSplats { means, rotations: of_rotations, log_scales, logit_opacities, sh };
                let rates = [rates.means.into(), rotations.into(), scales.into(), opacities.into(), sh_rates];
                let factors = Raw::from_array(rates.map(|rate| adam.factors(rate, step)));
                return self.step_at_once(grads, factors, verdict);
            }
            gradients => gradients,
        };
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let adam = (adam, step, verdict);
        update(&mut g.means, gradients.means, rates.means, &mut m.means, adam);
        update(&mut g.rotations, gradients.rotations, rotations, &mut m.rotations, adam);
        update(&mut g.log_scales, gradients.log_scales, scales, &mut m.log_scales, adam);
        update(&mut g.logit_opacities, gradients.logit_opacities, opacities, &mut m.logit_opacities, adam);
        update(&mut g.sh, gradients.sh, sh_rates, &mut m.sh, adam);
    }

    /// Takes one Adam step on all parameters by [`step_scene`].
    fn step_at_once(&mut self, grads: RawSplats, factors: Raw<Factors>, verdict: Option<&Tensor<1, Int>>) {
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let device = g.means.val().device();
        let coefficients = g.sh.id;
        let params = RawSplats {
            means: take(&mut g.means),
            rotations: take(&mut g.rotations),
            log_scales: take(&mut g.log_scales),
            logit_opacities: take(&mut g.logit_opacities),
            sh: take(&mut g.sh),
        };
        let (means_m, means_v) = sums(&mut m.means);
        let (rotations_m, rotations_v) = sums(&mut m.rotations);
        let (log_scales_m, log_scales_v) = sums(&mut m.log_scales);
        let (logit_opacities_m, logit_opacities_v) = sums(&mut m.logit_opacities);
        let (sh_m, sh_v) = sums(&mut m.sh);
        let of_m = RawSplats {
            means: means_m,
            rotations: rotations_m,
            log_scales: log_scales_m,
            logit_opacities: logit_opacities_m,
            sh: sh_m,
        };
        let of_v = RawSplats {
            means: means_v,
            rotations: rotations_v,
            log_scales: log_scales_v,
            logit_opacities: logit_opacities_v,
            sh: sh_v,
        };
        let mark = self.mark.take().filter(|(id, _)| *id == coefficients).map(|(_, mark)| mark);
        let mark = mark.unwrap_or_else(|| Tensor::zeros([1], (&device.clone().inner(), DType::I32)));
        let from = SceneStep { params, grads, m: of_m, v: of_v };
        let SteppedScene { params, m: of_m, v: of_v, mark } = step_scene(from, verdict, mark, factors);
        g.means = parameter(on(&device, params.means));
        g.rotations = parameter(on(&device, params.rotations));
        g.log_scales = parameter(on(&device, params.log_scales));
        g.logit_opacities = parameter(on(&device, params.logit_opacities));
        g.sh = parameter(on(&device, params.sh));
        m.means = Moments::full(of_m.means, of_v.means);
        m.rotations = Moments::full(of_m.rotations, of_v.rotations);
        m.log_scales = Moments::full(of_m.log_scales, of_v.log_scales);
        m.logit_opacities = Moments::full(of_m.logit_opacities, of_v.logit_opacities);
        m.sh = Moments::full(of_m.sh, of_v.sh);
        self.mark = Some((g.sh.id, mark));
    }
}

/// `values` on the device of a parameter, tracked if that is an autodiff device.
pub(super) fn on<const D: usize>(device: &Device, values: Tensor<D>) -> Tensor<D> {
    if device.is_autodiff() { Tensor::from_inner(values) } else { values }
}

/// Replaces the values of a parameter.
pub(super) fn replace<const D: usize>(param: &mut Param<Tensor<D>>, values: Tensor<D>) {
    let device = param.val().device();
    *param = parameter(on(&device, values));
}

/// Moves the values out of a parameter, so that no other reference exists. Nothing is allocated for the parameter that stays.
pub(super) fn take<const D: usize>(param: &mut Param<Tensor<D>>) -> Tensor<D> {
    let device = param.val().device();
    let none = |device: &Device, _: bool| Tensor::zeros([0; D], device);
    let none = Param::uninitialized(ParamId::new(), none, device, false, Shape::from([0; D]));
    std::mem::replace(param, none).into_value().inner()
}

/// Moves the sums of a parameter out.
fn sums<const D: usize>(moments: &mut Moments<D>) -> (Tensor<D>, Tensor<D>) {
    match moments.take() {
        Stored::Full { m, v } => (m, v),
        Stored::Packed { .. } => unreachable!("the caller checked that all moments have 32 bits"),
    }
}

fn update<const D: usize>(
    param: &mut Param<Tensor<D>>,
    gradient: Option<Tensor<D>>,
    rate: impl Into<Rates>,
    moments: &mut Moments<D>,
    (adam, step, verdict): (&Adam, usize, Option<&Tensor<1, Int>>),
) {
    let Some(gradient) = gradient else { return };
    let device = param.val().device();
    let values = take(param);
    *param = parameter(on(&device, adam.step_unless(values, gradient, rate, moments, (step, verdict))));
}
