//! Reading tensors of Burn's two CPU backends as slices, without a copy where they are contiguous.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use std::ops::Deref;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Flex, NdArray, TensorMetadata};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;
use burn_ndarray::{NdArrayStorage, NdArrayTensor};

use crate::real::Real;

/// A backend whose tensors lie in this program's memory.
pub(crate) trait HostBackend: Backend {
    /// The elements of a tensor, row-major. The tensor must hold `F`.
    fn host<F: Real>(tensor: FloatTensor<Self>) -> Host<F>;

    /// A tensor of the given elements, row-major, on the device of `like`.
    fn from_host<F: Real>(elements: Vec<F>, shape: &[usize], like: &FloatTensor<Self>) -> FloatTensor<Self> {
        Self::float_from_data(TensorData::new(elements, shape.to_vec()), &like.device())
    }
}

/// A tensor's elements.
pub(crate) enum Host<F: Real> {
    Flex(FlexTensor),
    NdArray(NdArrayStorage<F>),
    Copied(Vec<F>),
}

impl<F: Real> Deref for Host<F> {
    type Target = [F];
    fn deref(&self) -> &[F] {
        match self {
            Self::Flex(tensor) => tensor.as_slice().expect("made contiguous when it was read, and of this type"),
            Self::NdArray(storage) => storage.view().to_slice().expect("found contiguous when it was read"),
            Self::Copied(elements) => elements,
        }
    }
}

impl HostBackend for Flex {
    fn host<F: Real>(tensor: FloatTensor<Self>) -> Host<F> {
        check_type::<F>(tensor.dtype());
        Host::Flex(if tensor.is_contiguous() { tensor } else { tensor.to_contiguous() })
    }
}

impl HostBackend for NdArray {
    fn host<F: Real>(tensor: FloatTensor<Self>) -> Host<F> {
        check_type::<F>(tensor.dtype());
        let storage = F::from_ndarray(tensor).expect("the type was just checked");
        if storage.view().is_standard_layout() {
            return Host::NdArray(storage);
        }
        Host::Copied(storage.view().iter().copied().collect())
    }
}

fn check_type<F: Real>(dtype: DType) {
    assert_eq!(dtype, F::DTYPE, "all tensors of a stage share one float type; the public functions check it");
}

/// The typed storage inside a tensor of the NdArray backend.
pub(crate) trait NdArrayReal: Sized + burn::tensor::Element {
    fn from_ndarray(tensor: NdArrayTensor) -> Option<NdArrayStorage<Self>>;
}

impl NdArrayReal for f32 {
    fn from_ndarray(tensor: NdArrayTensor) -> Option<NdArrayStorage<f32>> {
        if let NdArrayTensor::F32(storage) = tensor { Some(storage) } else { None }
    }
}

impl NdArrayReal for f64 {
    fn from_ndarray(tensor: NdArrayTensor) -> Option<NdArrayStorage<f64>> {
        if let NdArrayTensor::F64(storage) = tensor { Some(storage) } else { None }
    }
}
