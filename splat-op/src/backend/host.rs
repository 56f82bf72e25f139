//! Tensors of Burn's two CPU backends as slices, without a copy where they are contiguous.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use std::array;
use std::ops::Deref;

use burn::backend::TensorMetadata;
use burn::tensor::{DType, Element, Shape, TensorData};
use burn_flex::FlexTensor;
use burn_ndarray::NdArrayTensor;
use bytemuck::Pod;

use super::args::Args;
use crate::simd::Real;

/// A tensor in host memory.
#[derive(Clone)]
pub enum HostTensor {
    /// Of Flex.
    Flex(FlexTensor),
    /// Of NdArray.
    NdArray(NdArrayTensor),
}

/// Elements of a tensor, row-major.
pub enum Host<F> {
    /// Those of a tensor.
    #[doc(hidden)]
    Flex(FlexTensor),
    /// Those of a tensor.
    #[doc(hidden)]
    NdArray(NdArrayTensor),
    /// A copy.
    Copied(Vec<F>),
}

impl<F: Element + Pod> Deref for Host<F> {
    type Target = [F];
    fn deref(&self) -> &[F] {
        match self {
            Self::Flex(tensor) => tensor.as_slice().expect("made contiguous when it was read, and of this type"),
            Self::NdArray(tensor) => elements(tensor).expect("found contiguous when it was read, and of this type"),
            Self::Copied(elements) => elements,
        }
    }
}

/// Returns the elements of a tensor that holds `F` contiguously, row-major.
fn elements<F: Pod>(tensor: &NdArrayTensor) -> Option<&[F]> {
    match tensor {
        NdArrayTensor::F32(storage) => storage.view().to_slice().and_then(|s| bytemuck::try_cast_slice(s).ok()),
        NdArrayTensor::F64(storage) => storage.view().to_slice().and_then(|s| bytemuck::try_cast_slice(s).ok()),
        _ => None,
    }
}

/// Returns the elements of a tensor of any type.
fn flex<T>(tensor: &FlexTensor) -> Host<T> {
    // The slice of a tensor without elements may start beyond its end.
    if tensor.shape().num_elements() == 0 {
        return Host::Copied(Vec::new());
    }
    Host::Flex(if tensor.is_contiguous() { tensor.clone() } else { tensor.to_contiguous() })
}

fn narrowed<'a>(values: impl Iterator<Item = &'a i64>) -> Host<i32> {
    Host::Copied(values.map(|&value| i32::try_from(value).unwrap_or(-1)).collect())
}

impl HostTensor {
    pub(super) fn dtype(&self) -> DType {
        match self {
            Self::Flex(tensor) => tensor.dtype(),
            Self::NdArray(tensor) => tensor.dtype(),
        }
    }

    pub(super) fn shape(&self) -> Shape {
        match self {
            Self::Flex(tensor) => tensor.shape(),
            Self::NdArray(tensor) => tensor.shape(),
        }
    }

    pub(super) fn floats<F: Real>(&self) -> Host<F> {
        assert_eq!(self.dtype(), F::DTYPE, "all tensors of an operation share one float type");
        match self {
            Self::Flex(tensor) => flex(tensor),
            Self::NdArray(tensor) if elements::<F>(tensor).is_some() => Host::NdArray(tensor.clone()),
            Self::NdArray(NdArrayTensor::F32(storage)) => {
                Host::Copied(storage.view().iter().map(|&value| F::of(value.into())).collect())
            }
            Self::NdArray(NdArrayTensor::F64(storage)) => {
                Host::Copied(storage.view().iter().map(|&value| F::of(value)).collect())
            }
            Self::NdArray(other) => unreachable!("the type was just checked: {:?}", other.dtype()),
        }
    }

    /// Returns the same floats as f64; integers stay.
    fn widened(&self) -> Self {
        if self.dtype() != DType::F32 {
            return self.clone();
        }
        let values = self.floats::<f32>().iter().map(|&value| value.into()).collect::<Vec<f64>>();
        Self::Flex(FlexTensor::from_data(TensorData::new(values, self.shape())))
    }

    fn ints(&self) -> Host<i32> {
        match self {
            Self::Flex(tensor) if tensor.dtype() == DType::I64 => narrowed(flex::<i64>(tensor).iter()),
            Self::Flex(tensor) => flex(tensor),
            Self::NdArray(NdArrayTensor::I32(storage)) => Host::Copied(storage.view().iter().copied().collect()),
            Self::NdArray(NdArrayTensor::I64(storage)) => narrowed(storage.view().iter()),
            Self::NdArray(other) => unreachable!("the type is checked where tensors enter: {:?}", other.dtype()),
        }
    }
}

/// What a pass of an operation is given on a CPU. A tensor of another type than asked for panics too.
pub type HostArgs = Args<HostTensor>;

fn present(tensors: &[Option<HostTensor>], i: usize) -> &HostTensor {
    tensors[i].as_ref().expect("the caller gave this tensor")
}

impl HostArgs {
    /// Returns the same tensors with floats as f64.
    pub(super) fn widened(&self) -> Self {
        let all = |tensors: &[Option<HostTensor>]| {
            tensors.iter().map(|tensor| tensor.as_ref().map(HostTensor::widened)).collect()
        };
        let (inputs, outputs, grads) = (all(&self.inputs), all(&self.outputs), all(&self.grads));
        Self { inputs, outputs, grads, needs: self.needs.clone() }
    }

    /// Whether a tensor has this type.
    pub(super) fn holds(&self, dtype: DType) -> bool {
        self.all_present().any(|tensor| tensor.dtype() == dtype)
    }

    /// Returns the shape of input `i`.
    pub fn shape(&self, i: usize) -> Shape {
        present(&self.inputs, i).shape()
    }

    /// Returns the floats of input `i`.
    pub fn floats<F: Real>(&self, i: usize) -> Host<F> {
        present(&self.inputs, i).floats()
    }

    /// Returns the floats of the first `N` inputs.
    pub fn all<F: Real, const N: usize>(&self) -> [Host<F>; N] {
        array::from_fn(|i| self.floats(i))
    }

    /// Returns the integers of input `i`, i32 or i64. A number beyond i32 is −1.
    pub fn ints(&self, i: usize) -> Host<i32> {
        present(&self.inputs, i).ints()
    }

    /// In a backward pass, returns output `i` of the operation, if it keeps its outputs.
    pub fn output<F: Real>(&self, i: usize) -> Host<F> {
        present(&self.outputs, i).floats()
    }

    /// In a backward pass, returns the gradient of output `i`, if it has one.
    pub fn grad<F: Real>(&self, i: usize) -> Option<Host<F>> {
        self.grads[i].as_ref().map(HostTensor::floats)
    }

    /// In a backward pass, returns the gradient of the only output.
    pub fn only_grad<F: Real>(&self) -> Host<F> {
        present(&self.grads, 0).floats()
    }
}

/// An output of a pass on a CPU.
pub enum HostOutput {
    /// Elements, row-major.
    Data(TensorData),
    /// The elements of an input, contiguous in memory.
    Input(usize),
    /// In a backward pass, the gradient of an output.
    Grad(usize),
    /// An input times a number, in the input's memory if nothing else holds it.
    Scaled(usize, f64),
    /// In a backward pass, an output times its gradient.
    Product(usize),
    /// Nothing.
    Nothing,
}

impl HostOutput {
    /// Takes floats, row-major.
    pub fn floats<F: Real>(values: Vec<F>) -> Self {
        let len = values.len();
        Self::Data(TensorData::new(values, [len]))
    }

    /// Rounds floats to f32; all else stays.
    pub(super) fn narrowed(self) -> Self {
        match self {
            Self::Data(data) if data.dtype() == DType::F64 => Self::Data(data.convert::<f32>()),
            other => other,
        }
    }

    /// Takes integers, row-major.
    pub fn ints(values: Vec<i32>) -> Self {
        let len = values.len();
        Self::Data(TensorData::new(values, [len]))
    }
}

/// Returns outputs of floats.
pub(crate) fn float_outputs<F: Real>(outputs: impl IntoIterator<Item = Vec<F>>) -> Vec<HostOutput> {
    outputs.into_iter().map(HostOutput::floats).collect()
}

/// Returns the elements as slices.
pub(crate) fn slices<F: Element + Pod, const N: usize>(read: &[Host<F>; N]) -> [&[F]; N] {
    read.each_ref().map(|host| &host[..])
}
