//! Tensors of Burn's GPU backend as buffers, for every CubeCL runtime.

use std::array;

use burn::backend::TensorMetadata;
use burn::tensor::Shape;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use cubecl::client::Client;
use cubecl::server::Handle;

use super::args::Args;
use crate::gpu::{Buffer, Gpu};

/// Memory of an output of a pass on a GPU, row-major, if there is one.
pub type GpuOutput = Option<Handle>;

/// Returns the memory of outputs, of which some may be missing.
pub(crate) fn gpu_outputs<T>(outputs: impl IntoIterator<Item = impl Into<Option<Buffer<T>>>>) -> Vec<GpuOutput> {
    outputs.into_iter().map(|buffer| buffer.into().map(|buffer| buffer.handle)).collect()
}

/// Returns a tensor's elements, row-major.
pub(crate) fn buffer<T>(tensor: CubeTensor) -> Buffer<T> {
    let tensor = into_contiguous(tensor);
    let len = tensor.meta.num_elements();
    Buffer::from_handle(tensor.handle, len)
}

/// Returns the tensor itself if nothing else holds its memory, else a copy.
pub(crate) fn owned(tensor: CubeTensor) -> CubeTensor {
    let tensor = into_contiguous(tensor);
    if tensor.can_mut() { tensor } else { tensor.copy() }
}

/// What a pass of an operation is given on a GPU.
pub type GpuArgs = Args<CubeTensor>;

impl GpuArgs {
    /// Returns the client that launches kernels and allocates memory. Ask for it before the last tensor is taken.
    pub fn client(&self) -> &Client {
        &self.all_present().next().expect("a tensor is left").client
    }

    pub(crate) fn gpu(&self) -> Gpu {
        Gpu::new(self.client())
    }

    /// Returns input `i`.
    pub fn tensor(&self, i: usize) -> &CubeTensor {
        self.inputs[i].as_ref().expect("the caller gave this tensor")
    }

    /// Takes input `i`. An output may reuse its memory if nothing else holds it.
    pub fn take(&mut self, i: usize) -> CubeTensor {
        self.inputs[i].take().expect("the caller gave this tensor")
    }

    /// Returns the shape of input `i`.
    pub fn shape(&self, i: usize) -> Shape {
        self.tensor(i).shape()
    }

    /// Returns the memory of input `i`, row-major.
    pub fn handle(&self, i: usize) -> Handle {
        into_contiguous(self.tensor(i).clone()).handle
    }

    /// Returns input `i`, whose elements have four bytes.
    pub(crate) fn buffer<T>(&self, i: usize) -> Buffer<T> {
        buffer(self.tensor(i).clone())
    }

    /// Returns input `i` if there is one.
    pub(crate) fn optional<T>(&self, i: usize) -> Option<Buffer<T>> {
        self.inputs[i].clone().map(buffer)
    }

    /// Returns the floats of the first `N` inputs.
    pub(crate) fn all<const N: usize>(&self) -> [Buffer<f32>; N] {
        array::from_fn(|i| self.buffer(i))
    }

    /// In a backward pass, returns output `i` of the operation, if it keeps its outputs.
    pub fn output(&self, i: usize) -> &CubeTensor {
        self.outputs[i].as_ref().expect("the operation keeps its outputs")
    }

    /// In a backward pass, returns the gradient of output `i`, if it has one.
    pub fn grad(&self, i: usize) -> Option<CubeTensor> {
        self.grads[i].clone()
    }

    /// In a backward pass, returns the memory of the gradient of output `i`, row-major.
    pub fn grad_handle(&self, i: usize) -> Handle {
        into_contiguous(self.grad(i).expect("the output has a gradient")).handle
    }

    /// In a backward pass, returns the gradient of the only output.
    pub(crate) fn only_grad(&self) -> Buffer<f32> {
        buffer(self.grad(0).expect("the only output has a gradient"))
    }
}
