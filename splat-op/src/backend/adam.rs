//! Adam's step as an extension of Burn's GPU backend. Not differentiable.

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::{DType, Shape};
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;

use super::cube::{buffer, owned};
use crate::adam::launch::{DeviceState, launch_adam, launch_watch};
use crate::adam::rule::{Factors, VERDICT};
use crate::gpu::{Buffer, Gpu};

/// Condition under which a step is skipped.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub enum Held<B: Backend> {
    /// The step is never skipped.
    Never,
    /// The step is skipped if this verdict, `[2]`, names a step.
    By(IntTensor<B>),
}

/// A parameter, its gradient and its moments, all of one shape.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct AdamInputs<B: Backend> {
    /// The parameter.
    pub param: FloatTensor<B>,
    /// Gradient of the parameter.
    pub grad: FloatTensor<B>,
    /// First moment, `Σ β₁ᵏ g`.
    pub m: FloatTensor<B>,
    /// Second moment, `Σ β₂ᵏ g²`.
    pub v: FloatTensor<B>,
    /// Condition under which the step is skipped.
    #[extension_type]
    pub held: Held<B>,
}

/// A parameter and its moments after a step.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct AdamState<B: Backend> {
    /// The parameter.
    pub param: FloatTensor<B>,
    /// First moment, `Σ β₁ᵏ g`.
    pub m: FloatTensor<B>,
    /// Second moment, `Σ β₂ᵏ g²`.
    pub v: FloatTensor<B>,
}

/// Adam's step and the verdict that makes it skip, on GPU backends only; see `adam/`.
#[backend_extension(Cube, Fusion: cfg(feature = "fusion"))]
pub trait AdamBackend: Backend {
    /// Performs one step.
    #[fusion(meta = adam_meta)]
    fn adam(#[extension_type] inputs: AdamInputs<Self>, factors: Factors) -> AdamState<Self>;

    /// Returns the verdict, `[2]`, after a check of `values`.
    #[fusion(dtype = DType::I32, shape = Shape::from([VERDICT]))]
    fn watch(values: FloatTensor<Self>, verdict: IntTensor<Self>, at_step: u32, bit: u32) -> IntTensor<Self>;
}

#[cfg(feature = "fusion")]
fn adam_meta(inputs: &AdamInputsMetadata, _: &Factors) -> AdamStateMetadata {
    AdamStateMetadata { param: inputs.param.clone(), m: inputs.m.clone(), v: inputs.v.clone() }
}

/// Returns a verdict in the type that the kernels use: step and bits are not negative.
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
