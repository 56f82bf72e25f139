//! A scene in training, and edits of its rows: the only place that changes rows of parameters and of their moments.

mod gradients;
mod harmonics;

use std::borrow::Cow;

use burn::module::{Param, ParamId};
use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use splat_op::adam::{Factors, Raw, SceneStep, SteppedScene, step_scene, steps_scenes};
use splat_op::{RawSplats, Splats};

pub use self::gradients::Gradients;
use self::harmonics::{first_and_more, put_harmonics, take_harmonics};
use crate::gaussians::{GaussianRows, Gaussians, RowsError, parameter};
use crate::optim::moments::Stored;
use crate::optim::{Adam, LearningRates, MomentBits, Moments, Rates};
use crate::state::{State, StateError};

/// Adam moments of all parameters of a scene.
#[derive(Clone, Debug)]
pub struct GaussianMoments {
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

    fn sh_blocks(&self) -> impl Iterator<Item = &Moments<3>> {
        std::iter::once(&self.sh).chain(&self.sh_more)
    }
}

/// A scene in training: parameters and moments, always with the same rows.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The parameters.
    pub gaussians: Gaussians,
    pub(crate) moments: GaussianMoments,
    /// The mark of the last step on a GPU (see [`splat_op::adam`]), and the coefficients that it holds for.
    mark: Option<(ParamId, Tensor<1, Int>)>,
}

/// One edit of all rows. Kept rows come before added rows.
#[derive(Clone, Debug, Default)]
pub struct RowEdit {
    /// Indices of the kept rows, in their new order.
    pub keep: Vec<u32>,
    /// Added rows, whose moments are zero.
    pub add: GaussianRows,
}

impl Trained {
    /// A scene with zero moments.
    pub fn new(gaussians: Gaussians) -> Self {
        Self::with_bits(gaussians, MomentBits::ThirtyTwo)
    }

    /// A scene with zero moments of so many bits.
    pub fn with_bits(gaussians: Gaussians, bits: MomentBits) -> Self {
        let moments = GaussianMoments::new(&gaussians, bits);
        Self { gaussians, moments, mark: None }
    }

    /// The Gaussians with activated parameters, see [`Gaussians::splats`].
    pub(crate) fn splats(&self) -> Splats {
        // Whatever replaces coefficients gives them another identity.
        let mark = self.mark.as_ref().filter(|(id, _)| *id == self.gaussians.sh.id);
        self.gaussians.splats_with(mark.map(|(_, mark)| mark))
    }

    /// Has all coefficients looked at again, after code that may have changed them.
    pub(crate) fn forget_mark(&mut self) {
        self.mark = None;
    }

    /// Keeps, reorders and adds rows.
    ///
    /// # Errors
    /// If the added rows are inconsistent or have another degree than the scene.
    ///
    /// # Panics
    /// If `keep` names a row that does not exist, which is a bug of the strategy.
    pub fn edit(&mut self, edit: &RowEdit) -> Result<(), RowsError> {
        let device = self.gaussians.means.val().device().inner();
        let sh_degree = self.gaussians.sh_degree();
        let rows = match edit.add.sh_degree == sh_degree {
            true => Cow::Borrowed(&edit.add),
            // No rows have any degree.
            false => Cow::Owned(GaussianRows { sh_degree, ..edit.add.clone() }),
        };
        let (keep, added) = (indices(&edit.keep, &device), Gaussians::from_rows(&rows, &device)?);
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        edit_rows(&mut g.means, &mut m.means, &keep, &added.means);
        edit_rows(&mut g.rotations, &mut m.rotations, &keep, &added.rotations);
        edit_rows(&mut g.log_scales, &mut m.log_scales, &keep, &added.log_scales);
        edit_rows(&mut g.logit_opacities, &mut m.logit_opacities, &keep, &added.logit_opacities);
        self.edit_sh(&edit.keep, &keep, &added);
        Ok(())
    }

    /// Replaces the opacities' logits and sets their moments to zero.
    pub fn reset_opacities(&mut self, logits: Tensor<1>) {
        self.moments.logit_opacities = self.moments.logit_opacities.anew(&logits);
        replace(&mut self.gaussians.logit_opacities, logits);
    }

    /// Replaces the centres and keeps their moments.
    pub fn replace_means(&mut self, means: Tensor<2>) {
        replace(&mut self.gaussians.means, means);
    }

    /// Replaces the logarithms of the standard deviations and keeps their moments.
    pub fn replace_log_scales(&mut self, log_scales: Tensor<2>) {
        replace(&mut self.gaussians.log_scales, log_scales);
    }

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
            } if steps_scenes(&means) && self.moments.means.bits() == MomentBits::ThirtyTwo => {
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

    /// Saves parameters and moments.
    pub fn save(&self) -> State {
        let (g, m) = (&self.gaussians, &self.moments);
        let mut state = State::default();
        put_parameter(&mut state, "means", &g.means, &m.means);
        put_parameter(&mut state, "rotations", &g.rotations, &m.rotations);
        put_parameter(&mut state, "log_scales", &g.log_scales, &m.log_scales);
        put_parameter(&mut state, "logit_opacities", &g.logit_opacities, &m.logit_opacities);
        put_harmonics(&mut state, g, m);
        state
    }

    /// Restores a scene with moments of so many bits. It can be trained if `device` is an autodiff device.
    ///
    /// # Errors
    /// If a value is missing, or if parameters and moments are inconsistent.
    pub fn load(from: &mut State, bits: MomentBits, device: &Device) -> Result<Self, StateError> {
        let (means, of_means) = take_parameter::<2>(from, "means", (bits, device), |shape| *shape == [shape[0], 3])?;
        let count = means.val().dims()[0];
        let (rotations, of_rotations) =
            take_parameter::<2>(from, "rotations", (bits, device), |shape| *shape == [count, 4])?;
        let (log_scales, of_log_scales) =
            take_parameter::<2>(from, "log_scales", (bits, device), |shape| *shape == [count, 3])?;
        let (logit_opacities, of_opacities) =
            take_parameter::<1>(from, "logit_opacities", (bits, device), |shape| *shape == [count])?;
        let is_sh = |&[rows, coefficients, channels]: &[usize; 3]| {
            let largest = splat_op::sh::SH_DEGREE_MAX + 1;
            let side = coefficients.isqrt();
            rows == count && (1..=largest).contains(&side) && side * side == coefficients && channels == 3
        };
        let (sh, of_sh) = take_harmonics(from, (bits, device), is_sh)?;
        let ((sh, sh_more), (of_sh, of_sh_more)) = (first_and_more(sh), first_and_more(of_sh));
        Ok(Self {
            gaussians: Gaussians { means, rotations, log_scales, logit_opacities, sh, sh_more },
            moments: GaussianMoments {
                means: of_means,
                rotations: of_rotations,
                log_scales: of_log_scales,
                logit_opacities: of_opacities,
                sh: of_sh,
                sh_more: of_sh_more,
            },
            mark: None,
        })
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

/// `values` on the device of a parameter, tracked if that is an autodiff device.
fn on<const D: usize>(device: &Device, values: Tensor<D>) -> Tensor<D> {
    if device.is_autodiff() { Tensor::from_inner(values) } else { values }
}

/// Replaces the values of a parameter.
fn replace<const D: usize>(param: &mut Param<Tensor<D>>, values: Tensor<D>) {
    let device = param.val().device();
    *param = parameter(on(&device, values));
}

/// Moves the values out of a parameter, so that no other reference exists.
fn take<const D: usize>(param: &mut Param<Tensor<D>>) -> Tensor<D> {
    let (device, dtype) = (param.val().device(), param.val().dtype());
    let empty = parameter(Tensor::zeros([0; D], (&device, dtype)));
    std::mem::replace(param, empty).into_value().inner()
}

/// Moves the sums of a parameter out.
fn sums<const D: usize>(moments: &mut Moments<D>) -> (Tensor<D>, Tensor<D>) {
    match moments.take().0 {
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

/// Row indices as a tensor.
fn indices(rows: &[u32], device: &Device) -> Tensor<1, Int> {
    let rows: Vec<i32> = rows.iter().map(|&row| row as i32).collect();
    let count = rows.len();
    Tensor::from_data(TensorData::new(rows, [count]), device)
}

/// The rows `keep`, `[K]`, followed by the added rows, whose moments are zero.
fn edit_rows<const D: usize>(
    param: &mut Param<Tensor<D>>,
    moments: &mut Moments<D>,
    keep: &Tensor<1, Int>,
    added: &Param<Tensor<D>>,
) {
    let (device, added) = (param.val().device(), added.val().inner());
    moments.edit(keep, added.dims()[0]);
    // The old rows are gone before the new ones are joined.
    let kept = take(param).select(0, keep.clone());
    *param = parameter(on(&device, Tensor::cat(vec![kept, added], 0)));
}

fn untracked<const D: usize>(values: Tensor<D>) -> Tensor<D> {
    if values.is_autodiff() { values.inner() } else { values }
}

fn put_parameter<const D: usize>(to: &mut State, name: &str, param: &Param<Tensor<D>>, moments: &Moments<D>) {
    to.in_part(name, |part| {
        part.put("values", untracked(param.val()));
        moments.save(part);
    });
}

/// A parameter on `device`, and its moments. Returns an error if `fits` rejects the shape.
fn take_parameter<const D: usize>(
    from: &mut State,
    name: &str,
    (bits, device): (MomentBits, &Device),
    fits: impl Fn(&[usize; D]) -> bool,
) -> Result<(Param<Tensor<D>>, Moments<D>), StateError> {
    let plain = device.clone().inner();
    from.load_part(name, |part| {
        let values = part.take::<D>("values", &plain)?;
        let shape = values.dims();
        if !fits(&shape) {
            return Err(part.shape_error("values", shape.to_vec(), "one that fits the other arrays"));
        }
        Ok((parameter(on(device, values)), Moments::load_with_bits(part, shape, bits, &plain)?))
    })
}

#[cfg(test)]
mod tests;
