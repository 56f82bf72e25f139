//! The operations as an extension of Burn's GPU backend. Neither is differentiable.

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::{DType, Int, Shape, Tensor};
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;

use super::launch::{DeviceState, launch_adam, launch_watch};
use super::{Factors, Stepped, VERDICT};
use crate::bind::cube::{buffer, owned};
use crate::gpu::{Buffer, Gpu};

/// What may hold a step back.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub enum Held<B: Backend> {
    /// Nothing.
    Never,
    /// A verdict, `[2]`.
    By(IntTensor<B>),
}

/// A parameter, its gradient and its moments, of one shape.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct AdamInputs<B: Backend> {
    /// The parameter.
    pub param: FloatTensor<B>,
    /// Its gradient.
    pub grad: FloatTensor<B>,
    /// `Σ β₁ᵏ g`
    pub m: FloatTensor<B>,
    /// `Σ β₂ᵏ g²`
    pub v: FloatTensor<B>,
    /// What may hold the step back.
    #[extension_type]
    pub held: Held<B>,
}

/// A parameter and its moments after a step.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct AdamState<B: Backend> {
    /// The parameter.
    pub param: FloatTensor<B>,
    /// `Σ β₁ᵏ g`
    pub m: FloatTensor<B>,
    /// `Σ β₂ᵏ g²`
    pub v: FloatTensor<B>,
}

/// The operations of this module, on GPU backends alone.
#[backend_extension(Cube, Fusion: cfg(feature = "fusion"))]
pub trait AdamBackend: Backend {
    /// One step.
    #[fusion(meta = adam_meta)]
    fn adam(#[extension_type] inputs: AdamInputs<Self>, factors: Factors) -> AdamState<Self>;

    /// The verdict, `[2]`, after a look at `values`.
    #[fusion(dtype = DType::I32, shape = Shape::from([VERDICT]))]
    fn watch(values: FloatTensor<Self>, verdict: IntTensor<Self>, at_step: u32, bit: u32) -> IntTensor<Self>;
}

#[cfg(feature = "fusion")]
fn adam_meta(inputs: &AdamInputsMetadata, _: &Factors) -> AdamStateMetadata {
    AdamStateMetadata { param: inputs.param.clone(), m: inputs.m.clone(), v: inputs.v.clone() }
}

/// A verdict as the kernels see it: step and bits are not negative.
fn verdict_buffer(verdict: &CubeTensor) -> Buffer<u32> {
    debug_assert!(verdict.dtype == DType::I32 && verdict.shape().num_elements() == VERDICT);
    Buffer::from_handle(verdict.handle.clone(), VERDICT)
}

impl AdamBackend for CubeBackend {
    fn adam(inputs: AdamInputs<Self>, factors: Factors) -> AdamState<Self> {
        let AdamInputs { param, grad, m, v, held } = inputs;
        let gpu = Gpu::new(&param.client);
        let [param, m, v] = [param, m, v].map(owned);
        let state = DeviceState { param: buffer(param.clone()), m: buffer(m.clone()), v: buffer(v.clone()) };
        let verdict = match &held {
            Held::Never => None,
            Held::By(verdict) => Some(verdict_buffer(verdict)),
        };
        let band = factors.rate.band(param.shape().as_slice());
        launch_adam(&gpu, &state, &buffer(grad), verdict.as_ref(), &factors, band);
        AdamState { param, m, v }
    }

    fn watch(values: FloatTensor<Self>, verdict: IntTensor<Self>, at_step: u32, bit: u32) -> IntTensor<Self> {
        let gpu = Gpu::new(&values.client);
        let verdict = owned(verdict);
        launch_watch(&gpu, &buffer(values), &verdict_buffer(&verdict), at_step, bit);
        verdict
    }
}

/// See [`super::step()`].
pub(super) fn step<const D: usize>(
    from: Stepped<D>,
    grad: &Tensor<D>,
    verdict: Option<&Tensor<1, Int>>,
    factors: Factors,
) -> Stepped<D> {
    let inputs = AdamInputs {
        param: from.param.into_dispatch(),
        grad: grad.clone().into_dispatch(),
        m: from.m.into_dispatch(),
        v: from.v.into_dispatch(),
        held: verdict.map_or(Held::Never, |verdict| Held::By(verdict.clone().into_dispatch())),
    };
    let AdamState { param, m, v } = <Dispatch as AdamBackend>::adam(inputs, factors);
    Stepped { param: Tensor::from_dispatch(param), m: Tensor::from_dispatch(m), v: Tensor::from_dispatch(v) }
}

/// See [`super::watch()`].
pub(super) fn watch<const D: usize>(
    values: &Tensor<D>,
    verdict: Tensor<1, Int>,
    at_step: u32,
    bit: u32,
) -> Tensor<1, Int> {
    let (values, verdict) = (values.clone().into_dispatch(), verdict.into_dispatch());
    Tensor::from_dispatch(<Dispatch as AdamBackend>::watch(values, verdict, at_step, bit))
}
