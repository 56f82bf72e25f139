//! Adam's step as an extension of Burn's GPU backend. Not differentiable.

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::{DType, Shape};
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;

use super::cube::{buffer, owned};
#[cfg(feature = "fusion")]
use super::tensors::OptionalIntTensorMetadata;
use super::tensors::{OptionalIntTensor, OptionalTensor};
use crate::activate::rule::Raw;
use crate::adam::launch::{DeviceState, DeviceStep, launch_adam, launch_watch};
use crate::adam::packed::PackedFactors;
use crate::adam::packed::launch::{DevicePackedStep, launch_adam_packed};
use crate::adam::rule::{Factors, VERDICT};
use crate::gpu::{Buffer, Gpu};

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

/// A parameter, its gradient and its packed moments.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct PackedInputs<B: Backend> {
    /// The parameter, `[N, …]`.
    pub param: FloatTensor<B>,
    /// Gradient of the parameter.
    pub grad: FloatTensor<B>,
    /// The moments, `[N, words]`.
    pub words: IntTensor<B>,
}

/// A parameter and its packed moments after a step.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct PackedState<B: Backend> {
    /// The parameter.
    pub param: FloatTensor<B>,
    /// The moments.
    pub words: IntTensor<B>,
}

/// The parameters of a scene with their gradients and moments.
pub type SceneInputs<B> = Raw<AdamInputs<B>>;
/// The parameters of a scene with their moments.
pub type SceneStates<B> = Raw<AdamState<B>>;
/// The gradients of a scene's parameters.
pub type SceneGradientTensors<B> = Raw<OptionalTensor<B>>;

/// A scene after a step.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct SceneState<B: Backend> {
    /// The parameters.
    #[extension_type]
    pub states: SceneStates<B>,
    /// `[1]`: the mark, zero if all coefficients are usable.
    pub mark: IntTensor<B>,
}

/// Adam's step and the verdict that makes it skip, on GPU backends only; see `adam/`.
#[backend_extension(Cube, Fusion: cfg(feature = "fusion"))]
pub trait AdamBackend: Backend {
    /// Performs one step, unless the verdict, `[2]`, names a step.
    #[fusion(meta = adam_meta)]
    fn adam(
        #[extension_type] inputs: AdamInputs<Self>,
        #[extension_type] verdict: OptionalIntTensor<Self>,
        factors: Factors,
    ) -> AdamState<Self>;

    /// Performs one step of all parameters of a scene, unless the verdict, `[2]`, names a step. Sets the mark, `[1]`, if a coefficient
    /// is not usable afterwards, or if nobody looked.
    #[fusion(meta = scene_meta)]
    fn adam_scene(
        #[extension_type] inputs: SceneInputs<Self>,
        #[extension_type] verdict: OptionalIntTensor<Self>,
        mark: IntTensor<Self>,
        factors: Raw<Factors>,
    ) -> SceneState<Self>;

    /// Performs one step of a parameter with packed moments, unless the verdict, `[2]`, names a step.
    #[fusion(meta = packed_meta)]
    fn adam_packed(
        #[extension_type] inputs: PackedInputs<Self>,
        #[extension_type] verdict: OptionalIntTensor<Self>,
        factors: PackedFactors,
    ) -> PackedState<Self>;

    /// Returns the verdict, `[2]`, after a check of the loss and of the gradients.
    #[fusion(dtype = DType::I32, shape = Shape::from([VERDICT]))]
    fn watch(
        loss: FloatTensor<Self>,
        #[extension_type] gradients: SceneGradientTensors<Self>,
        verdict: IntTensor<Self>,
        at_step: u32,
    ) -> IntTensor<Self>;
}

#[cfg(feature = "fusion")]
fn adam_meta(inputs: &AdamInputsMetadata, _: &OptionalIntTensorMetadata, _: &Factors) -> AdamStateMetadata {
    state_meta(inputs)
}

#[cfg(feature = "fusion")]
fn state_meta(inputs: &AdamInputsMetadata) -> AdamStateMetadata {
    AdamStateMetadata { param: inputs.param.clone(), m: inputs.m.clone(), v: inputs.v.clone() }
}

#[cfg(feature = "fusion")]
fn scene_meta(
    inputs: &Raw<AdamInputsMetadata>,
    _: &OptionalIntTensorMetadata,
    mark: &burn::backend::fusion::custom::TensorSpec,
    _: &Raw<Factors>,
) -> SceneStateMetadata {
    SceneStateMetadata { states: inputs.each_ref().map(state_meta), mark: mark.clone() }
}

#[cfg(feature = "fusion")]
fn packed_meta(inputs: &PackedInputsMetadata, _: &OptionalIntTensorMetadata, _: &PackedFactors) -> PackedStateMetadata {
    PackedStateMetadata { param: inputs.param.clone(), words: inputs.words.clone() }
}

/// Returns a tensor of integers in the type that the kernels use: none of theirs is negative, or they are bits.
fn unsigned(tensor: &CubeTensor, len: usize) -> Buffer<u32> {
    debug_assert!(tensor.dtype == DType::I32 && tensor.shape().num_elements() == len);
    Buffer::from_handle(tensor.handle.clone(), len)
}

/// Prepares the step of a parameter, in place where nothing else holds the memory.
fn prepared(inputs: AdamInputs<CubeBackend>, factors: Factors) -> (DeviceStep, AdamState<CubeBackend>) {
    let AdamInputs { param, grad, m, v } = inputs;
    let [param, m, v] = [param, m, v].map(owned);
    let state = DeviceState { param: buffer(param.clone()), m: buffer(m.clone()), v: buffer(v.clone()) };
    let band = factors.rate.band(param.shape().as_slice());
    (DeviceStep { state, grad: buffer(grad), factors, band }, AdamState { param, m, v })
}

impl AdamBackend for CubeBackend {
    fn adam(inputs: AdamInputs<Self>, verdict: OptionalIntTensor<Self>, factors: Factors) -> AdamState<Self> {
        let gpu = Gpu::new(&inputs.param.client);
        let verdict = verdict.into_option().map(|verdict| unsigned(&verdict, VERDICT));
        let (step, state) = prepared(inputs, factors);
        launch_adam(&gpu, &[&step], verdict.as_ref(), None);
        state
    }

    fn adam_scene(
        inputs: SceneInputs<Self>,
        verdict: OptionalIntTensor<Self>,
        mark: IntTensor<Self>,
        factors: Raw<Factors>,
    ) -> SceneState<Self> {
        let gpu = Gpu::new(&mark.client);
        let verdict = verdict.into_option().map(|verdict| unsigned(&verdict, VERDICT));
        let mark = owned(mark);
        let all = inputs.zip(factors).map(|(inputs, factors)| prepared(inputs, factors));
        let Raw { means, rotations, log_scales, logit_opacities, sh } = all.each_ref().map(|(step, _)| step);
        // Two launches: a kernel may have 16 buffers, and a parameter takes four.
        launch_adam(&gpu, &[means, rotations, log_scales], verdict.as_ref(), None);
        launch_adam(&gpu, &[logit_opacities, sh], verdict.as_ref(), Some(&unsigned(&mark, 1)));
        SceneState { states: all.map(|(_, state)| state), mark }
    }

    fn adam_packed(
        inputs: PackedInputs<Self>,
        verdict: OptionalIntTensor<Self>,
        factors: PackedFactors,
    ) -> PackedState<Self> {
        let gpu = Gpu::new(&inputs.param.client);
        let verdict = verdict.into_option().map(|verdict| unsigned(&verdict, VERDICT));
        let (param, words) = (owned(inputs.param), owned(inputs.words));
        let shape = param.shape();
        let dims = shape.as_slice();
        let step = DevicePackedStep {
            param: buffer(param.clone()),
            grad: buffer(inputs.grad),
            words: unsigned(&words, words.shape().num_elements()),
            factors,
            band: factors.factors.rate.band(dims),
            width: dims[1..].iter().product(),
        };
        launch_adam_packed(&gpu, &step, verdict.as_ref());
        PackedState { param, words }
    }

    fn watch(
        loss: FloatTensor<Self>,
        gradients: SceneGradientTensors<Self>,
        verdict: IntTensor<Self>,
        at_step: u32,
    ) -> IntTensor<Self> {
        let gpu = Gpu::new(&loss.client);
        let verdict = owned(verdict);
        let gradients = gradients.map(|gradient| gradient.into_option().map(buffer));
        launch_watch(&gpu, &buffer(loss), &gradients, &unsigned(&verdict, VERDICT), at_step);
        verdict
    }
}
