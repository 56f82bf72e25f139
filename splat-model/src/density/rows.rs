//! The only place that edits rows: of the parameters and, with them, of their Adam moments.

mod state;

use burn::module::Param;
use burn::tensor::{Device, Int, Tensor, TensorData};

use crate::gaussians::{GaussianRows, Gaussians, RowsError, parameter};
use crate::optim::{Adam, LearningRates, Moments, Rates};

/// Adam's state for all parameters of a scene.
#[derive(Clone, Debug)]
pub struct GaussianMoments {
    pub(crate) means: Moments<2>,
    pub(crate) rotations: Moments<2>,
    pub(crate) log_scales: Moments<2>,
    pub(crate) logit_opacities: Moments<1>,
    pub(crate) sh: Moments<3>,
    pub(crate) sh_matte: Option<Moments<3>>,
}

impl GaussianMoments {
    /// No history.
    pub fn new(gaussians: &Gaussians) -> Self {
        Self {
            means: Moments::new(&gaussians.means.val()),
            rotations: Moments::new(&gaussians.rotations.val()),
            log_scales: Moments::new(&gaussians.log_scales.val()),
            logit_opacities: Moments::new(&gaussians.logit_opacities.val()),
            sh: Moments::new(&gaussians.sh.val()),
            sh_matte: gaussians.sh_matte.as_ref().map(|matte| Moments::new(&matte.val())),
        }
    }
}

/// A scene being trained: parameters and moments, always of the same rows.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The parameters.
    pub gaussians: Gaussians,
    pub(crate) moments: GaussianMoments,
}

/// One edit of all rows. What is left has those that are not matte first, and within both groups rows that stay before those
/// that come.
#[derive(Clone, Debug, Default)]
pub struct RowEdit {
    /// Rows that stay, in their new order.
    pub keep: Vec<u32>,
    /// Rows that come, without history.
    pub add: GaussianRows,
    /// Matte rows that come, of degree 0.
    pub add_matte: GaussianRows,
}

impl Trained {
    /// A scene without history.
    pub fn new(gaussians: Gaussians) -> Self {
        let moments = GaussianMoments::new(&gaussians);
        Self { gaussians, moments }
    }

    /// Keeps, reorders and adds rows.
    ///
    /// # Errors
    /// If the added rows do not fit together or are of another degree than the scene, or the matte ones of another than 0.
    ///
    /// # Panics
    /// If `keep` names a row that does not exist: that is a bug of the policy.
    pub fn edit(&mut self, edit: &RowEdit) -> Result<(), RowsError> {
        let device = self.gaussians.means.val().device().inner();
        let added =
            |rows: &GaussianRows, sh_degree| Gaussians::from_rows(&GaussianRows { sh_degree, ..rows.clone() }, &device);
        let first = self.gaussians.directional() as u32;
        let (keep, keep_matte): (Vec<u32>, Vec<u32>) = edit.keep.iter().partition(|row| **row < first);
        let mut groups = vec![Group::new(&keep, added(&edit.add, self.gaussians.sh_degree())?, &device)];
        let matte = Group::new(&keep_matte, added(&edit.add_matte, 0)?, &device);
        if !matte.is_empty() {
            groups.push(matte);
        }
        let (gaussians, moments) = (&mut self.gaussians, &mut self.moments);
        edit_rows(&mut gaussians.means, &mut moments.means, &groups, |added| &added.means);
        edit_rows(&mut gaussians.rotations, &mut moments.rotations, &groups, |added| &added.rotations);
        edit_rows(&mut gaussians.log_scales, &mut moments.log_scales, &groups, |added| &added.log_scales);
        edit_rows(&mut gaussians.logit_opacities, &mut moments.logit_opacities, &groups, |added| {
            &added.logit_opacities
        });
        edit_rows(&mut gaussians.sh, &mut moments.sh, &groups[..1], |added| &added.sh);
        let (param, history) = (&mut gaussians.sh_matte, &mut moments.sh_matte);
        match groups.get_mut(1) {
            None => (*param, *history) = (None, None),
            Some(group) => {
                group.keep = group.keep.clone() - first as i32;
                let param = param.get_or_insert_with(|| empty_like(&gaussians.sh));
                let history = history.get_or_insert_with(|| Moments::new(&param.val()));
                edit_rows(param, history, &groups[1..], |added| &added.sh);
            }
        }
        Ok(())
    }

    /// Takes the higher coefficients from `rows`, none of which is matte yet, in ascending order, and puts them first among the
    /// matte ones; they keep their history. Returns where each row has come from.
    ///
    /// # Panics
    /// If there is no such row, or it is matte: that is a bug of the policy.
    pub fn make_matte(&mut self, rows: &[u32]) -> Vec<u32> {
        let (first, count) = (self.gaussians.directional() as u32, self.gaussians.len() as u32);
        assert!(rows.is_sorted_by(|a, b| a < b) && rows.last().is_none_or(|row| *row < first));
        let stay: Vec<u32> = (0..first).filter(|row| rows.binary_search(row).is_err()).collect();
        let order: Vec<u32> = stay.iter().chain(rows).copied().chain(first..count).collect();
        if rows.is_empty() {
            return order;
        }
        let device = self.gaussians.means.val().device().inner();
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let [to, stay, gone] = [&order, &stay, rows].map(|rows| indices(rows, &device));
        change(&mut g.means, &mut m.means, |old| old.select(0, to.clone()));
        change(&mut g.rotations, &mut m.rotations, |old| old.select(0, to.clone()));
        change(&mut g.log_scales, &mut m.log_scales, |old| old.select(0, to.clone()));
        change(&mut g.logit_opacities, &mut m.logit_opacities, |old| old.select(0, to.clone()));
        // Those of degree 0, and before those that are matte already.
        let taken = |sh: Tensor<3>, matte: Option<Tensor<3>>| {
            let constant = sh.narrow(1, 0, 1).select(0, gone.clone());
            matte.map_or(constant.clone(), |matte| Tensor::cat(vec![constant, matte], 0))
        };
        let old = m.sh_matte.take();
        let m_and_v = old.map(|Moments { m, v }| (Some(m), Some(v))).unwrap_or_default();
        let history = Moments { m: taken(m.sh.m.clone(), m_and_v.0), v: taken(m.sh.v.clone(), m_and_v.1) };
        let values = taken(g.sh.val().inner(), g.sh_matte.as_ref().map(|matte| matte.val().inner()));
        m.sh_matte = Some(history);
        g.sh_matte = Some(parameter(on(&g.sh.val().device(), values)));
        change(&mut g.sh, &mut m.sh, |old| old.select(0, stay.clone()));
        order
    }

    /// Replaces the opacities' logits, whose history is forgotten.
    pub fn reset_opacities(&mut self, logits: Tensor<1>) {
        self.moments.logit_opacities = Moments::new(&logits);
        replace(&mut self.gaussians.logit_opacities, logits);
    }

    /// Replaces the centres and keeps their history.
    pub fn replace_means(&mut self, means: Tensor<2>) {
        replace(&mut self.gaussians.means, means);
    }

    /// Replaces the logarithms of the standard deviations and keeps their history.
    pub fn replace_log_scales(&mut self, log_scales: Tensor<2>) {
        replace(&mut self.gaussians.log_scales, log_scales);
    }

    /// Makes room for spherical harmonics up to `degree`: new coefficients and their moments are zero, just as if they
    /// had been there from the start with zero gradients.
    pub fn grow_sh(&mut self, degree: usize) {
        let wanted = (degree + 1) * (degree + 1);
        let values = self.gaussians.sh.val().inner();
        let [count, have, channels] = values.dims();
        if wanted <= have {
            return;
        }
        let zeros = Tensor::zeros([count, wanted - have, channels], (&values.device(), values.dtype()));
        let grown = |old: Tensor<3>| Tensor::cat(vec![old, zeros.clone()], 1);
        self.moments.sh.m.inplace(grown);
        self.moments.sh.v.inplace(grown);
        replace(&mut self.gaussians.sh, grown(values));
    }

    /// One step of Adam on every parameter that has a gradient; `step` counts from 1. With a verdict, `[2]` (see
    /// [`splat_op::adam`]), the device decides whether anything changes: nothing does where a step is entered in it.
    pub fn step(
        &mut self,
        gradients: Gradients,
        adam: &Adam,
        rates: &StepRates,
        step: usize,
        verdict: Option<&Tensor<1, Int>>,
    ) {
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let LearningRates { scales, rotations, sh_dc, sh_rest, opacities, .. } = rates.rates;
        let adam = (adam, step, verdict);
        update(&mut g.means, gradients.means, rates.means, &mut m.means, adam);
        update(&mut g.rotations, gradients.rotations, rotations, &mut m.rotations, adam);
        update(&mut g.log_scales, gradients.log_scales, scales, &mut m.log_scales, adam);
        update(&mut g.logit_opacities, gradients.logit_opacities, opacities, &mut m.logit_opacities, adam);
        update(&mut g.sh, gradients.sh, Rates { first: sh_dc, others: sh_rest }, &mut m.sh, adam);
        if let (Some(matte), Some(moments)) = (&mut g.sh_matte, &mut m.sh_matte) {
            update(matte, gradients.sh_matte, sh_dc, moments, adam);
        }
    }
}

/// Learning rates of one step.
#[derive(Clone, Copy, Debug)]
pub struct StepRates {
    /// Those that do not change.
    pub rates: LearningRates,
    /// Of the centres, scene units.
    pub means: f64,
}

/// Gradients of a scene's parameters, without autodiff; absent where the loss does not depend on one.
#[derive(Debug, Default)]
pub struct Gradients {
    /// `[N, 3]`, of the centres.
    pub means: Option<Tensor<2>>,
    /// `[N, 4]`, of the quaternions.
    pub rotations: Option<Tensor<2>>,
    /// `[N, 3]`, of the logarithms of the standard deviations.
    pub log_scales: Option<Tensor<2>>,
    /// `[N]`, of the opacities' logits.
    pub logit_opacities: Option<Tensor<1>>,
    /// `[N, (degree + 1)², 3]`, of the harmonics' coefficients.
    pub sh: Option<Tensor<3>>,
    pub sh_matte: Option<Tensor<3>>,
}

impl Gradients {
    /// Takes the gradients of a scene's parameters out of those of a loss.
    pub fn take(gaussians: &Gaussians, grads: &mut burn::tensor::Gradients) -> Self {
        Self {
            means: gaussians.means.val().grad_remove(grads),
            rotations: gaussians.rotations.val().grad_remove(grads),
            log_scales: gaussians.log_scales.val().grad_remove(grads),
            logit_opacities: gaussians.logit_opacities.val().grad_remove(grads),
            sh: gaussians.sh.val().grad_remove(grads),
            sh_matte: gaussians.sh_matte.as_ref().and_then(|matte| matte.val().grad_remove(grads)),
        }
    }
}

impl Gradients {
    /// The sum; what is absent counts as zero.
    pub fn plus(self, other: Self) -> Self {
        fn sum<const D: usize>(a: Option<Tensor<D>>, b: Option<Tensor<D>>) -> Option<Tensor<D>> {
            match (a, b) {
                (Some(a), Some(b)) => Some(a + b),
                (a, b) => a.or(b),
            }
        }
        Self {
            means: sum(self.means, other.means),
            rotations: sum(self.rotations, other.rotations),
            log_scales: sum(self.log_scales, other.log_scales),
            logit_opacities: sum(self.logit_opacities, other.logit_opacities),
            sh: sum(self.sh, other.sh),
            sh_matte: sum(self.sh_matte, other.sh_matte),
        }
    }

    /// All of them times a factor.
    pub fn times(self, factor: f64) -> Self {
        Self {
            means: self.means.map(|grad| grad * factor),
            rotations: self.rotations.map(|grad| grad * factor),
            log_scales: self.log_scales.map(|grad| grad * factor),
            logit_opacities: self.logit_opacities.map(|grad| grad * factor),
            sh: self.sh.map(|grad| grad * factor),
            sh_matte: self.sh_matte.map(|grad| grad * factor),
        }
    }
}

/// `values` on the device of a parameter, tracked if that is an autodiff device.
fn on<const D: usize>(device: &Device, values: Tensor<D>) -> Tensor<D> {
    if device.is_autodiff() { Tensor::from_inner(values) } else { values }
}

/// Puts new values in a parameter's place.
fn replace<const D: usize>(param: &mut Param<Tensor<D>>, values: Tensor<D>) {
    let device = param.val().device();
    *param = parameter(on(&device, values));
}

/// Takes the values out of a parameter, so that nothing else holds them.
fn take<const D: usize>(param: &mut Param<Tensor<D>>) -> Tensor<D> {
    let (device, dtype) = (param.val().device(), param.val().dtype());
    let empty = parameter(Tensor::zeros([0; D], (&device, dtype)));
    std::mem::replace(param, empty).into_value().inner()
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

/// Rows of one kind, matte or not.
struct Group {
    /// `[K]`: those that stay.
    keep: Tensor<1, Int>,
    /// Those that come after them.
    added: Gaussians,
}

impl Group {
    fn new(keep: &[u32], added: Gaussians, device: &Device) -> Self {
        Self { keep: indices(keep, device), added }
    }

    fn is_empty(&self) -> bool {
        self.keep.dims()[0] == 0 && self.added.is_empty()
    }
}

/// Numbers of rows, on a device.
pub(super) fn indices(rows: &[u32], device: &Device) -> Tensor<1, Int> {
    let rows: Vec<i32> = rows.iter().map(|&row| row as i32).collect();
    let count = rows.len();
    Tensor::from_data(TensorData::new(rows, [count]), device)
}

/// No matte coefficients, where those of the others are.
fn empty_like(sh: &Param<Tensor<3>>) -> Param<Tensor<3>> {
    let (device, dtype) = (sh.val().device(), sh.val().dtype());
    parameter(Tensor::zeros([0, 1, 3], (&device, dtype)))
}

/// Changes a parameter and its moments in the same way.
fn change<const D: usize>(
    param: &mut Param<Tensor<D>>,
    moments: &mut Moments<D>,
    changed: impl Fn(Tensor<D>) -> Tensor<D>,
) {
    moments.m.inplace(&changed);
    moments.v.inplace(&changed);
    replace(param, changed(param.val().inner()));
}

/// Of each group the rows that stay, then those that come, `field` of which is this parameter's.
fn edit_rows<const D: usize>(
    param: &mut Param<Tensor<D>>,
    moments: &mut Moments<D>,
    groups: &[Group],
    field: impl Fn(&Gaussians) -> &Param<Tensor<D>>,
) {
    let added: Vec<Tensor<D>> = groups.iter().map(|group| field(&group.added).val().inner()).collect();
    let without_history: Vec<Tensor<D>> = added.iter().map(Tensor::zeros_like).collect();
    let edited = |old: Tensor<D>, new: &[Tensor<D>]| {
        let rows = |(group, new): (&Group, &Tensor<D>)| [old.clone().select(0, group.keep.clone()), new.clone()];
        Tensor::cat(groups.iter().zip(new).flat_map(rows).collect(), 0)
    };
    let values = edited(param.val().inner(), &added);
    moments.m = edited(moments.m.clone(), &without_history);
    moments.v = edited(moments.v.clone(), &without_history);
    replace(param, values);
}

#[cfg(test)]
mod matte_tests;
#[cfg(test)]
mod tests;
