//! Adam (Kingma and Ba 2015, algorithm 1) on one parameter tensor at a time.

use burn::backend::Flex;
use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use rayon::prelude::*;
pub use splat_op::adam::Rates;
use splat_op::adam::packed::{HostState, PackedFactors, PackedStep, step_on_host, step_packed};
use splat_op::adam::{Band, Factors, Stepped, has_kernel};
use splat_op::is_tensor_code;

use super::moments::{Moments, Stored};

/// Gradients are clamped to ± this before they are squared: in f32, `1e17² / (1 − β₂)` is still finite. Steps stay
/// bounded by the learning rate either way, because Adam is invariant to the gradient's length.
const LARGEST_GRADIENT: f64 = 1e17;

options! {
    /// The optimiser's constants; its state is in [`Moments`].
    #[derive(Copy)]
    pub struct Adam {
        /// Share of the first moment that is kept per step, 0.9.
        pub beta1: f64 = 0.9,
        /// Share of the second moment that is kept per step, 0.999.
        pub beta2: f64 = 0.999,
        /// Added to the root of the second moment, 1e-15: the value of the original implementation. Gradients of single Gaussians
        /// are tiny, and the usual 1e-8 would shorten their steps.
        pub eps: f64 = 1e-15,
    }
}

impl Adam {
    /// Returns the constants for steps of `views` photographs each, whose gradients are averaged. `βᵛ` forgets as much per
    /// photograph as `β` does. Gradients have `√views` times less noise, so `ε / √views` has the same weight. With learning
    /// rates `√views` times as large this is the square-root scaling rule of Malladi et al. (2022, "On the SDEs and Scaling
    /// Rules for Adaptive Gradient Algorithms"), which gsplat also has. Their `1 − views (1 − β)` is the first order of the
    /// power, and negative from ten views on; Zhao et al. use the power ("On Scaling Up 3D Gaussian Splatting Training", 2024).
    pub fn for_batch(self, views: usize) -> Self {
        let views = views as f64;
        Self { beta1: self.beta1.powf(views), beta2: self.beta2.powf(views), eps: self.eps / views.sqrt() }
    }

    /// Returns the parameter after step `t`, counted from 1, with learning rate `lr` (one for all, or [`Rates`]): with bias
    /// correction, `param − lr · m̂ / (√v̂ + ε)`.
    ///
    /// `param`, `grad` and `moments` have one shape and no autodiff. A gradient of zero without history changes nothing. An
    /// infinite gradient counts as 1e17; `v` forgets it at the rate β₂, so its row hardly moves for thousands of steps. NaN is
    /// passed on: the operation that computes the gradient must not return it.
    ///
    /// Panics if the shapes differ.
    ///
    /// Storage is reused if no other tensor shares it: take `grad` with `grad_remove`, and pass `param` without a clone.
    pub fn step<const D: usize>(
        &self,
        param: Tensor<D>,
        grad: Tensor<D>,
        lr: impl Into<Rates>,
        moments: &mut Moments<D>,
        t: usize,
    ) -> Tensor<D> {
        self.step_unless(param, grad, lr, moments, t, None)
    }

    /// Computes [`Self::step`], but changes nothing if the device's verdict, `[2]`, holds a step (see [`splat_op::adam`]).
    pub(crate) fn step_unless<const D: usize>(
        &self,
        param: Tensor<D>,
        grad: Tensor<D>,
        lr: impl Into<Rates>,
        moments: &mut Moments<D>,
        step: usize,
        verdict: Option<&Tensor<1, Int>>,
    ) -> Tensor<D> {
        assert_eq!(param.shape(), grad.shape(), "a gradient has the shape of its parameter");
        let factors = self.factors(lr.into(), step);
        let (m, v) = match moments.take() {
            Stored::Full { m, v } => (m, v),
            Stored::Packed(words) => {
                let factors = PackedFactors { factors, step: step as u32 };
                let (param, words) = packed_step(param, grad, words, &factors, verdict);
                *moments = Moments::packed(words);
                return param;
            }
        };
        assert_eq!(param.shape(), m.shape(), "moments have the shape of their parameter");
        let from = Stepped { param, m, v };
        let Stepped { param, m, v } = match verdict {
            // One operation does the whole step.
            _ if has_kernel(&from.param) => splat_op::adam::step(from, &grad, verdict, factors),
            Some(verdict) => {
                let old = from.clone();
                let new = step_in_tensors(&factors, from, grad);
                let held = verdict.clone().narrow(0, 0, 1).not_equal_elem(0).reshape([1; D]).expand(old.param.shape());
                let kept = |new: Tensor<D>, old| new.mask_where(held.clone(), old);
                Stepped { param: kept(new.param, old.param), m: kept(new.m, old.m), v: kept(new.v, old.v) }
            }
            // Flex works in host memory and hands it over without a copy. One fused pass over it on all cores takes a third
            // of the time of the tensor operations, which are eleven passes on one core.
            None if from.param.device() == Device::flex() && from.param.dtype() == DType::F32 && !is_tensor_code() => {
                step_in_host_memory(&factors, from, grad)
            }
            None => step_in_tensors(&factors, from, grad),
        };
        *moments = Moments::full(m, v);
        param
    }

    /// The scalars of one step, combined so that tensors are traversed as few times as possible.
    pub(crate) fn factors(&self, lr: Rates, t: usize) -> Factors {
        // √v̂ = c √v and m̂ = b m; both factors move out of the tensors: lr m̂ / (√v̂ + ε) = (lr b/c) m / (√v + ε/c).
        let t = t as f64;
        let b = (1.0 - self.beta1) / (1.0 - self.beta1.powf(t));
        let c = ((1.0 - self.beta2) / (1.0 - self.beta2.powf(t))).sqrt();
        let (rate, floor) = (lr.times(b / c), self.eps / c);
        Factors { beta1: self.beta1, beta2: self.beta2, rate, floor, largest: LARGEST_GRADIENT }
    }
}

fn step_in_tensors<const D: usize>(factors: &Factors, from: Stepped<D>, grad: Tensor<D>) -> Stepped<D> {
    let Stepped { param, m, v } = from;
    let grad = grad.clamp(-LARGEST_GRADIENT, LARGEST_GRADIENT);
    let m = m * factors.beta1 + grad.clone();
    let v = v * factors.beta2 + grad.square();
    let root = v.clone().sqrt() + factors.floor;
    let ratio = m.clone() / root;
    Stepped { param: param - rated(factors.rate, ratio), m, v }
}

fn rated<const D: usize>(rate: Rates, ratio: Tensor<D>) -> Tensor<D> {
    let dims = ratio.dims();
    let Some(Band { period, width }) = rate.band(&dims) else { return ratio * rate.others };
    if period == width {
        return ratio * rate.first;
    }
    let rows: Tensor<2> = ratio.reshape([dims[0], period]);
    let first = rows.clone().narrow(1, 0, width) * rate.first;
    let others = rows.narrow(1, width, period - width) * rate.others;
    Tensor::cat(vec![first, others], 1).reshape(dims)
}

/// Computes the step for f32 on a device whose tensors are in host memory.
fn step_in_host_memory<const D: usize>(factors: &Factors, from: Stepped<D>, grad: Tensor<D>) -> Stepped<D> {
    let Stepped { param, m, v } = from;
    let options = (&param.device(), DType::F32);
    let band = factors.rate.band(&param.dims());
    let [mut param, grad, mut m, mut v] = [param, grad, m, v].map(host_data);
    step_slices(factors, values_mut(&mut param), values(&grad), values_mut(&mut m), values_mut(&mut v), band);
    let [param, m, v] = [param, m, v].map(|data| Tensor::from_data(data, options));
    Stepped { param, m, v }
}

/// Performs the step with packed moments: on a GPU in one operation, elsewhere in host memory. Returns the parameter and the words.
fn packed_step<const D: usize>(
    param: Tensor<D>,
    grad: Tensor<D>,
    words: Tensor<2, Int>,
    factors: &PackedFactors,
    verdict: Option<&Tensor<1, Int>>,
) -> (Tensor<D>, Tensor<2, Int>) {
    if has_kernel(&param) {
        let PackedStep { param, words } = step_packed(PackedStep { param, words }, &grad, verdict, *factors);
        return (param, words);
    }
    if verdict.is_some_and(|verdict| verdict.clone().into_data().iter::<i64>().next() != Some(0)) {
        return (param, words);
    }
    assert_eq!(param.dtype(), DType::F32, "moments are packed for parameters in f32");
    let (dims, device) = (param.dims(), param.device());
    let (width, band) = (dims[1..].iter().product::<usize>().max(1), factors.factors.rate.band(&dims));
    let is_flex = device == Device::flex();
    let [mut param, grad] = [param, grad].map(|tensor| if is_flex { host_data(tensor) } else { tensor.into_data() });
    let mut words = match is_flex {
        true => words.try_into_primitive::<Flex>().expect("as in `host_data`").into_data(),
        false => words.into_data(),
    };
    let of_words = words.as_mut_slice::<i32>().expect("words are created as i32");
    let state = HostState { param: values_mut(&mut param), grad: values(&grad), words: of_words };
    step_on_host(state, width, band, factors);
    (Tensor::from_data(param, (&device, DType::F32)), Tensor::from_data(words, (&device, DType::I32)))
}

/// Returns the elements of a tensor on Flex. `Tensor::into_data` would move a future that has room for those of all backends,
/// which costs more than a step of a small parameter.
fn host_data<const D: usize>(tensor: Tensor<D>) -> TensorData {
    tensor.try_into_primitive::<Flex>().expect("the caller checked the device, and that nothing is tracked").into_data()
}

fn step_slices(factors: &Factors, param: &mut [f32], grad: &[f32], m: &mut [f32], v: &mut [f32], band: Option<Band>) {
    // 64 KiB of each array: large enough to hide the scheduling, small enough to balance the load.
    const CHUNK: usize = 16_384;
    let rates = pattern(factors.rate, band);
    let chunk = CHUNK.next_multiple_of(rates.len());
    let moments = m.par_chunks_mut(chunk).zip(v.par_chunks_mut(chunk));
    param.par_chunks_mut(chunk).zip(grad.par_chunks(chunk)).zip(moments).for_each(|((param, grad), (m, v))| {
        let moments = m.chunks_mut(rates.len()).zip(v.chunks_mut(rates.len()));
        let numbers = param.chunks_mut(rates.len()).zip(grad.chunks(rates.len())).zip(moments);
        for ((param, grad), (m, v)) in numbers {
            step_chunk(factors, param, grad, m, v, &rates);
        }
    });
}

/// The repeating pattern of the rates of a parameter's numbers, in whole periods and whole vectors.
fn pattern(rate: Rates, band: Option<Band>) -> Vec<f32> {
    const LANES: usize = 16;
    let Band { period, width } = band.unwrap_or(Band { period: 64, width: 0 });
    let of = |at: usize| if at % period < width { rate.first } else { rate.others };
    (0..LANES * period).map(|at| of(at) as f32).collect()
}

fn step_chunk(factors: &Factors, param: &mut [f32], grad: &[f32], m: &mut [f32], v: &mut [f32], rates: &[f32]) {
    // A constant bound, because a clamp between variables checks their order per element and is not vectorised.
    const LARGEST: f32 = LARGEST_GRADIENT as f32;
    let (beta1, beta2) = (factors.beta1 as f32, factors.beta2 as f32);
    let floor = factors.floor as f32;
    for ((((param, grad), m), v), rate) in param.iter_mut().zip(grad).zip(m).zip(v).zip(rates) {
        let grad = grad.clamp(-LARGEST, LARGEST);
        *m = *m * beta1 + grad;
        *v = *v * beta2 + grad * grad;
        *param -= *m / (v.sqrt() + floor) * *rate;
    }
}

fn values(data: &TensorData) -> &[f32] {
    data.as_slice().expect("the caller checked that the parameter is f32, and its gradient and moments are like it")
}

fn values_mut(data: &mut TensorData) -> &mut [f32] {
    data.as_mut_slice().expect("the caller checked that the parameter is f32, and its moments are like it")
}

#[cfg(test)]
mod tests;
