//! Operations bound to Burn's backends and to fusion, once for all of them.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use std::sync::Arc;

#[cfg(feature = "fusion")]
use burn::backend::fusion::custom::TensorSpec;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, Flex, NdArray, TensorMetadata, backend_extension};
use burn::tensor::{DType, Int, Tensor, TensorData};
#[cfg(feature = "cube")]
use burn_cubecl::{CubeBackend, tensor::CubeTensor};

use super::args::Args;
#[cfg(feature = "cube")]
use super::cube::GpuOutput;
use super::host::{HostOutput, HostTensor};
#[cfg(feature = "fusion")]
use super::list::SlotMetadata;
use super::list::{List, Slot, Tensors};
use super::operation::{Call, Operation, Spec};
use crate::counters::count_twin_calls;

/// A Burn backend that runs operations. With fusion, an operation on the GPU is registered first and runs later.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait OperationBackend: Backend {
    /// Runs one pass of an operation.
    #[fusion(meta = |inputs, call| metadata(inputs, call))]
    fn operate(#[extension_type] inputs: Tensors<Self>, call: Call) -> Tensors<Self>;
}

/// The outputs of an operation.
#[derive(Debug)]
pub struct Outputs(Vec<Slot<Dispatch>>);

impl Outputs {
    /// Takes an output of floats.
    ///
    /// # Panics
    /// If there is no such output, or if it was taken.
    pub fn float<const D: usize>(&mut self, i: usize) -> Tensor<D> {
        match std::mem::replace(&mut self.0[i], Slot::Absent) {
            Slot::Float(tensor) => Tensor::from_dispatch(tensor),
            other => panic!("output {i} is {other:?}, not floats"),
        }
    }

    /// Takes an output of integers.
    ///
    /// # Panics
    /// As [`float`](Self::float).
    pub fn int<const D: usize>(&mut self, i: usize) -> Tensor<D, Int> {
        match std::mem::replace(&mut self.0[i], Slot::Absent) {
            Slot::Int(tensor) => Tensor::from_dispatch(tensor),
            other => panic!("output {i} is {other:?}, not integers"),
        }
    }
}

/// Runs an operation on tensors of one device, at least one of them present.
///
/// # Panics
/// If an output's specification does not match what the operation computed.
pub fn apply<const N: usize>(operation: impl Operation, inputs: [Slot<Dispatch>; N]) -> Outputs {
    apply_all(operation, inputs.into())
}

/// [`apply`] to any number of inputs.
pub(crate) fn apply_all(operation: impl Operation, inputs: Vec<Slot<Dispatch>>) -> Outputs {
    let call = Call { operation: Arc::new(operation), backward: None };
    Outputs(<Dispatch as OperationBackend>::operate(List(inputs), call).0)
}

/// Returns the metadata of a call's outputs from those of its inputs.
#[cfg(feature = "fusion")]
fn metadata(inputs: &List<SlotMetadata>, call: &Call) -> List<SlotMetadata> {
    let spec = |slot: &SlotMetadata| match slot {
        SlotMetadata::Absent => None,
        SlotMetadata::Float(spec) | SlotMetadata::Int(spec) => {
            Some(Spec { shape: spec.shape.clone(), dtype: spec.dtype })
        }
    };
    let given: Vec<_> = inputs.0.iter().map(spec).collect();
    List(call.outputs(&given)).map(|spec| match spec {
        None => SlotMetadata::Absent,
        Some(Spec { shape, dtype }) if dtype.is_float() => SlotMetadata::Float(TensorSpec::new(shape, dtype)),
        Some(Spec { shape, dtype }) => SlotMetadata::Int(TensorSpec::new(shape, dtype)),
    })
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
    let args = call.args(given);
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

#[cfg(feature = "cube")]
impl OperationBackend for CubeBackend {
    fn operate(inputs: Tensors<Self>, call: Call) -> Tensors<Self> {
        let given: Vec<Option<CubeTensor>> = inputs.0.into_iter().map(tensor).collect();
        let like = given.iter().flatten().next().expect("an operation has an input");
        let (client, device) = (like.client.clone(), like.device.clone());
        let spec = |tensor: &CubeTensor| Spec { shape: tensor.shape(), dtype: tensor.dtype };
        let specs = call.outputs(&given.iter().map(|tensor| tensor.as_ref().map(spec)).collect::<Vec<_>>());
        let found = call.operation.launch(call.args(given), call.backward.is_some());
        assert_eq!(found.len(), specs.len(), "an operation has the outputs that it specified");
        let output = |(found, spec): (GpuOutput, Option<Spec>)| match (found, spec) {
            (Some(handle), Some(Spec { shape, dtype })) => {
                let bytes = (shape.num_elements() * dtype.size()) as u64;
                // Kernels read it unchecked.
                assert!(handle.size_in_used() >= bytes, "an output of {bytes} bytes has {}", handle.size_in_used());
                let made = CubeTensor::new_contiguous(client.clone(), device.clone(), shape, handle, dtype);
                if dtype.is_float() { Slot::Float(made) } else { Slot::Int(made) }
            }
            _ => Slot::Absent,
        };
        List(found.into_iter().zip(specs).map(output).collect())
    }
}

#[cfg(feature = "cube")]
fn tensor(slot: Slot<CubeBackend>) -> Option<CubeTensor> {
    match slot {
        Slot::Absent => None,
        Slot::Float(tensor) | Slot::Int(tensor) => Some(tensor),
    }
}
