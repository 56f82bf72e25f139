//! Records of tensors that are passed to a backend and back.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{
    Autodiff, Backend, BackendTensor, Dispatch, DispatchAutodiffContext, DispatchTensor, DispatchTensorKind,
    ExtensionType,
};
use burn::tensor::{Int, Tensor};

use crate::activate::rule::Raw;
use crate::bilateral::Sliced;
use crate::colour_map::Mapped;
use crate::depth_miss::Depths;
use crate::environment::Sky;
use crate::loss::taps::Compared;
use crate::optics::Exposed;
use crate::pose::{Corrected, Sighted};
use crate::project::Geometry;
use crate::rasterize::{Layers, PlaneParts};
use crate::rasterize_rays::RayLayers;
use crate::sh::Shading;
use crate::smooth::Smooth;

/// A tensor in a record of inputs.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct InputTensor<B: Backend>(pub FloatTensor<B>);

impl<const D: usize> From<Tensor<D>> for InputTensor<Dispatch> {
    fn from(tensor: Tensor<D>) -> Self {
        Self(tensor.into_dispatch())
    }
}

impl<B: Backend, C: CheckpointStrategy> InputTensor<Autodiff<B, C>> {
    /// Returns the tensor without autodiff.
    pub(super) fn inner(&self) -> InputTensor<B> {
        InputTensor(self.0.primitive().clone())
    }
}

/// A gradient that may not have been asked for, or an optional input tensor.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub enum OptionalTensor<B: Backend> {
    /// No tensor.
    Absent,
    /// A tensor.
    Present(FloatTensor<B>),
}

impl<B: Backend> OptionalTensor<B> {
    /// Returns the tensor, if there is one.
    pub(crate) fn into_option(self) -> Option<FloatTensor<B>> {
        match self {
            Self::Absent => None,
            Self::Present(tensor) => Some(tensor),
        }
    }
}

impl<B: Backend> From<Option<FloatTensor<B>>> for OptionalTensor<B> {
    fn from(tensor: Option<FloatTensor<B>>) -> Self {
        tensor.map_or(Self::Absent, Self::Present)
    }
}

impl<B: Backend, C: CheckpointStrategy> OptionalTensor<Autodiff<B, C>> {
    /// Returns the tensor without autodiff.
    pub(super) fn inner(self) -> OptionalTensor<B> {
        self.into_option().map(|tensor| tensor.into_primitive()).into()
    }

    /// Returns the tensor as a constant of the autodiff backend.
    pub(super) fn constant(inner: OptionalTensor<B>) -> Self {
        inner.into_option().map(FloatTensor::<Autodiff<B, C>>::new).into()
    }
}

/// An optional input tensor of integers.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub enum OptionalIntTensor<B: Backend> {
    /// No tensor.
    Absent,
    /// A tensor.
    Present(IntTensor<B>),
}

impl<B: Backend> OptionalIntTensor<B> {
    /// Returns the tensor, if there is one.
    #[cfg(feature = "cube")]
    pub(crate) fn into_option(self) -> Option<IntTensor<B>> {
        match self {
            Self::Absent => None,
            Self::Present(tensor) => Some(tensor),
        }
    }
}

impl From<Option<&Tensor<1, Int>>> for OptionalIntTensor<Dispatch> {
    fn from(tensor: Option<&Tensor<1, Int>>) -> Self {
        tensor.map_or(Self::Absent, |tensor| Self::Present(tensor.clone().into_dispatch()))
    }
}

/// Inputs of `project` and `ray_space`.
pub type GeometryTensors<B> = Geometry<InputTensor<B>>;
/// Gradients of the inputs of `project` and `ray_space`.
pub type GeometryGrads<B> = Geometry<OptionalTensor<B>>;
/// Inputs of `evaluate_sh`.
pub type ShadingTensors<B> = Shading<InputTensor<B>>;
/// Gradients of the inputs of `evaluate_sh`.
pub type ShadingGrads<B> = Shading<OptionalTensor<B>>;
/// Inputs of `rasterize`.
pub type LayerTensors<B> = Layers<InputTensor<B>>;
/// Gradients of the inputs of `rasterize`.
pub type LayerGrads<B> = Layers<OptionalTensor<B>>;
/// Gradients of the planes of `rasterize` and `rasterize_rays`.
pub type PlaneGrads<B> = PlaneParts<OptionalTensor<B>>;
/// Inputs of `rasterize_rays`.
pub type RayLayerTensors<B> = RayLayers<InputTensor<B>>;
/// Gradients of the inputs of `rasterize_rays`.
pub type RayLayerGrads<B> = RayLayers<OptionalTensor<B>>;
/// Inputs of `photometric`.
pub type ComparedTensors<B> = Compared<InputTensor<B>>;
/// Inputs of `bilateral_slice`.
pub type SliceTensors<B> = Sliced<InputTensor<B>>;
/// Gradients of the inputs of `bilateral_slice`.
pub type SliceGrads<B> = Sliced<OptionalTensor<B>>;
/// Inputs of `colour_map`.
pub type MappedTensors<B> = Mapped<InputTensor<B>>;
/// Gradients of the inputs of `colour_map`.
pub type MappedGrads<B> = Mapped<OptionalTensor<B>>;
/// Inputs of `environment`.
pub type SkyTensors<B> = Sky<InputTensor<B>>;
/// Gradients of the inputs of `environment`.
pub type SkyGrads<B> = Sky<OptionalTensor<B>>;
/// Inputs of `expose`.
pub type ExposedTensors<B> = Exposed<InputTensor<B>>;
/// Gradients of the inputs of `expose`.
pub type ExposedGrads<B> = Exposed<OptionalTensor<B>>;
/// Inputs of `smoothed_opacities`.
pub type SmoothTensors<B> = Smooth<InputTensor<B>>;
/// Gradients of the inputs of `smoothed_opacities`.
pub type SmoothGrads<B> = Smooth<OptionalTensor<B>>;
/// Inputs of `depth_miss`.
pub type DepthsTensors<B> = Depths<InputTensor<B>>;
/// Gradients of the inputs of `depth_miss`.
pub type DepthsGrads<B> = Depths<OptionalTensor<B>>;
/// Inputs of `corrected_pose`.
pub type CorrectedTensors<B> = Corrected<InputTensor<B>>;
/// Inputs of `pose_miss`.
pub type SightedTensors<B> = Sighted<InputTensor<B>>;
/// Inputs of `activated`.
pub type RawTensors<B> = Raw<InputTensor<B>>;

/// Implements Burn's extension type for a record of extension types: Burn's derive does so only for a struct over a backend.
macro_rules! crosses {
    ($($record:ident),*) => {$(
        impl<B: Backend, T: ExtensionType<B>> ExtensionType<B> for $record<T> {
            type Target = $record<T::Target>;

            fn map_to_dispatch<F>(self, map_kind: F, autodiff: DispatchAutodiffContext) -> Self::Target
            where
                F: Fn(BackendTensor<B>) -> DispatchTensorKind,
            {
                self.map(|field| field.map_to_dispatch(&map_kind, autodiff))
            }

            fn map_from_dispatch<F>(target: Self::Target, unwrap_kind: F) -> Self
            where
                F: Fn(DispatchTensor) -> BackendTensor<B>,
            {
                target.map(|field| T::map_from_dispatch(field, &unwrap_kind))
            }

            fn routing_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
                target.each_ref().into_array().into_iter().find_map(T::routing_tensor)
            }

            fn routing_float_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
                target.each_ref().into_array().into_iter().find_map(T::routing_float_tensor)
            }

            fn autodiff_context(target: &Self::Target) -> DispatchAutodiffContext {
                let fields = target.each_ref().into_array().into_iter();
                fields.map(T::autodiff_context).fold(DispatchAutodiffContext::Disabled, DispatchAutodiffContext::merge)
            }
        }
    )*};
}

crosses!(
    Geometry, Shading, Layers, PlaneParts, RayLayers, Raw, Compared, Sliced, Sky, Exposed, Smooth, Mapped, Corrected,
    Sighted, Depths
);

#[cfg(feature = "fusion")]
mod fused {
    use burn::backend::fusion::custom::{ExtensionMetadata, FusionValueAdapter, HandleContainer, TensorId, TensorIr};
    use burn::backend::fusion::{ExecutionError, FusionBackend, FusionRuntime, FusionTensor};

    use super::*;

    type Handles<B> = HandleContainer<<<B as FusionBackend>::FusionRuntime as FusionRuntime>::FusionHandle>;

    /// Implements the same for operations that Burn's fusion runs later.
    macro_rules! crosses_later {
        ($($record:ident),*) => {$(
            impl<T: ExtensionMetadata> ExtensionMetadata for $record<T> {
                type Metadata = $record<T::Metadata>;
                type Input = $record<T::Input>;
                type Output = $record<T::Output>;
            }

            impl<B: FusionBackend, T: FusionValueAdapter<B>> FusionValueAdapter<B> for $record<T> {
                type Metadata = $record<T::Metadata>;
                type Input = $record<T::Input>;
                type Output = $record<T::Output>;
                type Inner = $record<T::Inner>;
                type Fused = $record<T::Fused>;

                fn to_metadata(value: &Self::Fused) -> Self::Metadata {
                    value.each_ref().map(T::to_metadata)
                }

                fn visit_fused_tensors(
                    value: &Self::Fused,
                    visit: &mut impl FnMut(&FusionTensor<B::FusionRuntime>),
                ) {
                    value.each_ref().map(|field| T::visit_fused_tensors(field, visit));
                }

                fn tensor_count(meta: &Self::Metadata) -> usize {
                    meta.each_ref().map(T::tensor_count).into_array().into_iter().sum()
                }

                fn append_input_ir(value: Self::Fused, inputs: &mut Vec<TensorIr>) -> Self::Input {
                    value.map(|field| T::append_input_ir(field, inputs))
                }

                fn resolve_inputs(input: &Self::Input, handles: &mut Handles<B>) -> Self::Inner {
                    input.each_ref().map(|field| T::resolve_inputs(field, handles))
                }

                fn append_output_ir(
                    meta: &Self::Metadata,
                    out: &mut Vec<TensorIr>,
                    create: &mut impl FnMut() -> TensorId,
                ) -> Self::Output {
                    meta.each_ref().map(|field| T::append_output_ir(field, out, create))
                }

                fn validate_outputs(
                    value: &Self::Inner,
                    output: &Self::Output,
                    device: Option<&B::Device>,
                ) -> Result<(), ExecutionError> {
                    let fields = value.each_ref().zip(output.each_ref()).into_array();
                    fields.into_iter().try_for_each(|(value, output)| T::validate_outputs(value, output, device))
                }

                fn register_output_handles(value: Self::Inner, output: &Self::Output, handles: &mut Handles<B>) {
                    value.zip(output.each_ref()).map(|(value, output)| {
                        T::register_output_handles(value, output, handles);
                    });
                }

                fn build_fused_output(
                    meta: &Self::Metadata,
                    tensors: &mut std::vec::IntoIter<FusionTensor<B::FusionRuntime>>,
                ) -> Self::Fused {
                    meta.each_ref().map(|field| T::build_fused_output(field, tensors))
                }
            }
        )*};
    }

    crosses_later!(
        Geometry, Shading, Layers, PlaneParts, RayLayers, Raw, Compared, Sliced, Sky, Exposed, Smooth, Mapped,
        Corrected, Sighted, Depths
    );
}
