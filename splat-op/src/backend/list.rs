//! Lists of tensors that cross Burn's dispatch and fusion.

use std::fmt::{self, Debug, Formatter};

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{
    Backend, BackendTensor, Dispatch, DispatchAutodiffContext, DispatchTensor, DispatchTensorKind, ExtensionType,
};
use burn::tensor::{Int, Tensor};

/// A place in a list of inputs or outputs.
#[derive(Clone, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub enum Slot<B: Backend> {
    /// No tensor.
    Absent,
    /// A tensor of floats.
    Float(FloatTensor<B>),
    /// A tensor of integers.
    Int(IntTensor<B>),
}

// Derived, it would print all elements, by code for every type of element.
impl<B: Backend> Debug for Slot<B> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Absent => "Absent",
            Self::Float(_) => "Float",
            Self::Int(_) => "Int",
        })
    }
}

impl<B: Backend> Slot<B> {
    /// Returns the tensor of floats, if there is one.
    pub(super) fn float(self) -> Option<FloatTensor<B>> {
        if let Self::Float(tensor) = self { Some(tensor) } else { None }
    }
}

impl<const D: usize> From<Tensor<D>> for Slot<Dispatch> {
    fn from(tensor: Tensor<D>) -> Self {
        Self::Float(tensor.into_dispatch())
    }
}

impl<const D: usize> From<&Tensor<D>> for Slot<Dispatch> {
    fn from(tensor: &Tensor<D>) -> Self {
        tensor.clone().into()
    }
}

impl<const D: usize> From<Tensor<D, Int>> for Slot<Dispatch> {
    fn from(tensor: Tensor<D, Int>) -> Self {
        Self::Int(tensor.into_dispatch())
    }
}

impl<const D: usize> From<&Tensor<D, Int>> for Slot<Dispatch> {
    fn from(tensor: &Tensor<D, Int>) -> Self {
        tensor.clone().into()
    }
}

impl<T: Into<Self>> From<Option<T>> for Slot<Dispatch> {
    fn from(tensor: Option<T>) -> Self {
        tensor.map_or(Self::Absent, Into::into)
    }
}

/// A list of values of one type. Burn's derive takes fields alone, so its parts are written here.
#[derive(Clone, Debug)]
pub struct List<T>(pub Vec<T>);

/// A list of tensors.
pub type Tensors<B> = List<Slot<B>>;

impl<T> List<T> {
    pub(super) fn map<U>(self, f: impl FnMut(T) -> U) -> List<U> {
        List(self.0.into_iter().map(f).collect())
    }
}

impl<B: Backend, T: ExtensionType<B>> ExtensionType<B> for List<T> {
    type Target = List<T::Target>;

    fn map_to_dispatch<F>(self, map_kind: F, autodiff: DispatchAutodiffContext) -> Self::Target
    where
        F: Fn(BackendTensor<B>) -> DispatchTensorKind,
    {
        self.map(|value| value.map_to_dispatch(&map_kind, autodiff))
    }

    fn map_from_dispatch<F>(target: Self::Target, unwrap_kind: F) -> Self
    where
        F: Fn(DispatchTensor) -> BackendTensor<B>,
    {
        target.map(|value| T::map_from_dispatch(value, &unwrap_kind))
    }

    fn routing_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
        target.0.iter().find_map(T::routing_tensor)
    }

    fn routing_float_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
        target.0.iter().find_map(T::routing_float_tensor)
    }

    fn autodiff_context(target: &Self::Target) -> DispatchAutodiffContext {
        let contexts = target.0.iter().map(T::autodiff_context);
        contexts.fold(DispatchAutodiffContext::Disabled, DispatchAutodiffContext::merge)
    }
}

#[cfg(feature = "fusion")]
mod fused {
    use std::vec::IntoIter;

    use burn::backend::fusion::custom::{ExtensionMetadata, FusionValueAdapter, HandleContainer, TensorId, TensorIr};
    use burn::backend::fusion::{ExecutionError, FusionBackend, FusionRuntime, FusionTensor};

    use super::*;

    type Handles<B> = HandleContainer<<<B as FusionBackend>::FusionRuntime as FusionRuntime>::FusionHandle>;

    impl<T: ExtensionMetadata> ExtensionMetadata for List<T> {
        type Metadata = List<T::Metadata>;
        type Input = List<T::Input>;
        type Output = List<T::Output>;
    }

    impl<B: FusionBackend, T: FusionValueAdapter<B>> FusionValueAdapter<B> for List<T> {
        type Metadata = List<T::Metadata>;
        type Input = List<T::Input>;
        type Output = List<T::Output>;
        type Inner = List<T::Inner>;
        type Fused = List<T::Fused>;

        fn to_metadata(value: &Self::Fused) -> Self::Metadata {
            List(value.0.iter().map(T::to_metadata).collect())
        }

        fn visit_fused_tensors(value: &Self::Fused, visit: &mut impl FnMut(&FusionTensor<B::FusionRuntime>)) {
            value.0.iter().for_each(|value| T::visit_fused_tensors(value, visit));
        }

        fn tensor_count(meta: &Self::Metadata) -> usize {
            meta.0.iter().map(T::tensor_count).sum()
        }

        fn append_input_ir(value: Self::Fused, inputs: &mut Vec<TensorIr>) -> Self::Input {
            value.map(|value| T::append_input_ir(value, inputs))
        }

        fn resolve_inputs(input: &Self::Input, handles: &mut Handles<B>) -> Self::Inner {
            List(input.0.iter().map(|input| T::resolve_inputs(input, handles)).collect())
        }

        fn append_output_ir(
            meta: &Self::Metadata,
            out: &mut Vec<TensorIr>,
            create: &mut impl FnMut() -> TensorId,
        ) -> Self::Output {
            List(meta.0.iter().map(|meta| T::append_output_ir(meta, out, create)).collect())
        }

        fn validate_outputs(
            value: &Self::Inner,
            output: &Self::Output,
            device: Option<&B::Device>,
        ) -> Result<(), ExecutionError> {
            assert_eq!(value.0.len(), output.0.len(), "an operation has the outputs that it specified");
            value.0.iter().zip(&output.0).try_for_each(|(value, output)| T::validate_outputs(value, output, device))
        }

        fn register_output_handles(value: Self::Inner, output: &Self::Output, handles: &mut Handles<B>) {
            value.0.into_iter().zip(&output.0).for_each(|(value, output)| {
                T::register_output_handles(value, output, handles);
            });
        }

        fn build_fused_output(
            meta: &Self::Metadata,
            tensors: &mut IntoIter<FusionTensor<B::FusionRuntime>>,
        ) -> Self::Fused {
            List(meta.0.iter().map(|meta| T::build_fused_output(meta, tensors)).collect())
        }
    }
}
