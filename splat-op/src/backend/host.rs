//! Operations on Burn's two CPU backends: tensors as slices, without a copy where they are contiguous.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use std::array;
use std::ops::Deref;

use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Flex, NdArray, TensorMetadata};
use burn::tensor::{DType, Element, Shape, TensorData};
use burn_flex::FlexTensor;
use burn_ndarray::NdArrayTensor;
use bytemuck::Pod;

use super::list::{List, Slot, Tensors};
use super::operation::{Args, Call, OperationBackend, Spec};
use crate::counters::count_twin_calls;
use crate::simd::real::Real;

/// A tensor in host memory.
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
    fn dtype(&self) -> DType {
        match self {
            Self::Flex(tensor) => tensor.dtype(),
            Self::NdArray(tensor) => tensor.dtype(),
        }
    }

    fn shape(&self) -> Shape {
        match self {
            Self::Flex(tensor) => tensor.shape(),
            Self::NdArray(tensor) => tensor.shape(),
        }
    }

    fn floats<F: Real>(&self) -> Host<F> {
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
    pub(super) fn is_f64(&self) -> bool {
        self.all_present().any(|tensor| tensor.dtype() == DType::F64)
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

/// A backend whose tensors lie in host memory.
trait HostBackend: Backend {
    fn of_floats(tensor: FloatTensor<Self>) -> HostTensor;
    fn of_ints(tensor: IntTensor<Self>) -> HostTensor;
    fn into_floats(tensor: HostTensor) -> FloatTensor<Self>;

    /// Returns the same elements in contiguous memory.
    fn contiguous(tensor: FloatTensor<Self>) -> FloatTensor<Self>;
}

impl HostBackend for Flex {
    fn of_floats(tensor: FloatTensor<Self>) -> HostTensor {
        HostTensor::Flex(tensor)
    }

    fn of_ints(tensor: IntTensor<Self>) -> HostTensor {
        HostTensor::Flex(tensor)
    }

    fn into_floats(tensor: HostTensor) -> FloatTensor<Self> {
        let HostTensor::Flex(tensor) = tensor else { unreachable!("tensors of this backend") };
        tensor
    }

    fn contiguous(tensor: FloatTensor<Self>) -> FloatTensor<Self> {
        if tensor.is_contiguous() { tensor } else { tensor.to_contiguous() }
    }
}

impl HostBackend for NdArray {
    fn of_floats(tensor: FloatTensor<Self>) -> HostTensor {
        HostTensor::NdArray(tensor)
    }

    fn of_ints(tensor: IntTensor<Self>) -> HostTensor {
        HostTensor::NdArray(tensor)
    }

    fn into_floats(tensor: HostTensor) -> FloatTensor<Self> {
        let HostTensor::NdArray(tensor) = tensor else { unreachable!("tensors of this backend") };
        tensor
    }

    fn contiguous(tensor: FloatTensor<Self>) -> FloatTensor<Self> {
        let host = HostTensor::NdArray(tensor.clone());
        let data = match tensor.dtype() {
            DType::F64 => TensorData::new(host.floats::<f64>().to_vec(), tensor.shape()),
            _ => TensorData::new(host.floats::<f32>().to_vec(), tensor.shape()),
        };
        Self::float_from_data(data, &tensor.device())
    }
}

fn operate<B: HostBackend>(inputs: Tensors<B>, call: &Call) -> Tensors<B> {
    let device = inputs.0.iter().find_map(|slot| match slot {
        Slot::Absent => None,
        Slot::Float(tensor) => Some(tensor.device()),
        Slot::Int(tensor) => Some(tensor.device()),
    });
    let device = device.expect("an operation has an input");
    let host = |slot: Slot<B>| match slot {
        Slot::Absent => None,
        Slot::Float(tensor) => Some(B::of_floats(tensor)),
        Slot::Int(tensor) => Some(B::of_ints(tensor)),
    };
    let given: Vec<Option<HostTensor>> = inputs.0.into_iter().map(host).collect();
    let spec = |tensor: &HostTensor| Spec { shape: tensor.shape(), dtype: tensor.dtype() };
    let specs = call.outputs(&given.iter().map(|tensor| tensor.as_ref().map(spec)).collect::<Vec<_>>());
    let args = Args::new(call, given);
    count_twin_calls(1);
    let found = call.operation.run(&args, call.backward.is_some());
    assert_eq!(found.len(), specs.len(), "an operation has the outputs that it specified");
    let Args { mut inputs, mut outputs, mut grads, .. } = args;
    let take = |tensors: &mut [Option<HostTensor>], i: usize| {
        B::into_floats(tensors[i].take().expect("it is there, and passed on once"))
    };
    let output = |(output, spec): (HostOutput, Option<Spec>)| {
        let Some(spec) = spec else { return Slot::Absent };
        Slot::Float(match output {
            HostOutput::Data(data) => {
                let (bytes, _, dtype) = data.into_parts();
                let data = TensorData::from_bytes(bytes, spec.shape, dtype);
                if !dtype.is_float() {
                    return Slot::Int(B::int_from_data(data, &device));
                }
                B::float_from_data(data, &device)
            }
            HostOutput::Input(i) => B::contiguous(take(&mut inputs, i)),
            HostOutput::Grad(i) => B::contiguous(take(&mut grads, i)),
            HostOutput::Scaled(i, factor) => B::float_mul_scalar(take(&mut inputs, i), factor.into()),
            HostOutput::Product(i) => B::float_mul(take(&mut outputs, i), take(&mut grads, i)),
            HostOutput::Nothing => return Slot::Absent,
        })
    };
    List(found.into_iter().zip(specs).map(output).collect())
}

impl OperationBackend for Flex {
    fn operate(inputs: Tensors<Self>, call: Call) -> Tensors<Self> {
        operate(inputs, &call)
    }
}

impl OperationBackend for NdArray {
    fn operate(inputs: Tensors<Self>, call: Call) -> Tensors<Self> {
        operate(inputs, &call)
    }
}
