//! Access to tensors of Burn's two CPU backends as slices, without a copy where they are contiguous.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use std::ops::Deref;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Flex, NdArray, TensorMetadata};
use burn::tensor::{DType, Element, TensorData, f16};
use burn_flex::FlexTensor;
use burn_ndarray::NdArrayTensor;
use bytemuck::Pod;

use crate::sh::cpu::ShCoefficients;
use crate::simd::real::Real;

/// Runs a CPU twin: evaluates `$body` with `$float` as the float type of `$tensor`.
macro_rules! by_type {
    ($tensor:expr, $float:ident => $body:expr) => {{
        $crate::counters::count_twin_call();
        match $tensor.dtype() {
            ::burn::tensor::DType::F64 => {
                type $float = f64;
                $body
            }
            _ => {
                type $float = f32;
                $body
            }
        }
    }};
}

/// A backend whose tensors lie in host memory.
pub(crate) trait HostBackend: Backend {
    /// Reads the elements of a tensor, row-major. The tensor must hold `F`.
    fn host<F: Real>(tensor: FloatTensor<Self>) -> Host<F>;

    /// Reads the elements of a half-precision tensor, row-major.
    fn host_halves(tensor: FloatTensor<Self>) -> Host<f16>;

    /// Reads the elements of a tensor of i32 or i64, row-major. A number beyond i32 is −1.
    fn host_ints(tensor: IntTensor<Self>) -> Host<i32>;

    /// Returns the same elements in contiguous memory.
    fn contiguous(tensor: FloatTensor<Self>) -> FloatTensor<Self>;

    /// Reads coefficients of half precision or of type `F`.
    fn host_coefficients<F: Real>(tensor: FloatTensor<Self>) -> HostCoefficients<F> {
        match tensor.dtype() {
            DType::F16 => HostCoefficients::Half(Self::host_halves(tensor)),
            _ => HostCoefficients::Full(Self::host(tensor)),
        }
    }

    /// Makes a tensor from elements, row-major, on the device of `like`.
    fn from_host<F: Real>(elements: Vec<F>, shape: &[usize], like: &FloatTensor<Self>) -> FloatTensor<Self> {
        Self::float_from_data(TensorData::new(elements, shape.to_vec()), &like.device())
    }
}

/// Elements of a tensor.
pub(crate) enum Host<F> {
    Flex(FlexTensor),
    NdArray(NdArrayTensor),
    Copied(Vec<F>),
}

/// Coefficients of spherical harmonics, in the precision of their tensor.
pub(crate) enum HostCoefficients<F> {
    Full(Host<F>),
    Half(Host<f16>),
}

impl<F: Real> HostCoefficients<F> {
    pub fn view(&self) -> ShCoefficients<'_, F> {
        match self {
            Self::Full(values) => ShCoefficients::Full(values),
            Self::Half(halves) => ShCoefficients::Half(halves),
        }
    }
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

/// Returns the elements of a tensor of any type.
fn flex<T>(tensor: FlexTensor) -> Host<T> {
    // The slice of a tensor without elements may start beyond its end.
    if tensor.shape().num_elements() == 0 {
        return Host::Copied(Vec::new());
    }
    Host::Flex(if tensor.is_contiguous() { tensor } else { tensor.to_contiguous() })
}

fn narrowed<'a>(values: impl Iterator<Item = &'a i64>) -> Host<i32> {
    Host::Copied(values.map(|&value| i32::try_from(value).unwrap_or(-1)).collect())
}

impl HostBackend for Flex {
    fn host<F: Real>(tensor: FloatTensor<Self>) -> Host<F> {
        check_type::<F>(tensor.dtype());
        flex(tensor)
    }

    fn host_halves(tensor: FloatTensor<Self>) -> Host<f16> {
        flex(tensor)
    }

    fn contiguous(tensor: FloatTensor<Self>) -> FloatTensor<Self> {
        tensor.to_contiguous()
    }

    fn host_ints(tensor: IntTensor<Self>) -> Host<i32> {
        match tensor.dtype() {
            DType::I64 => narrowed(flex::<i64>(tensor).iter()),
            _ => flex(tensor),
        }
    }
}

impl HostBackend for NdArray {
    fn host<F: Real>(tensor: FloatTensor<Self>) -> Host<F> {
        check_type::<F>(tensor.dtype());
        if elements::<F>(&tensor).is_some() {
            return Host::NdArray(tensor);
        }
        Host::Copied(match tensor {
            NdArrayTensor::F32(storage) => storage.view().iter().map(|&value| F::of(value.into())).collect(),
            NdArrayTensor::F64(storage) => storage.view().iter().map(|&value| F::of(value)).collect(),
            other => unreachable!("the type was just checked: {:?}", other.dtype()),
        })
    }

    fn host_halves(tensor: FloatTensor<Self>) -> Host<f16> {
        unreachable!("this backend has no tensors of half precision, and this one is of {:?}", tensor.dtype())
    }

    fn contiguous(tensor: FloatTensor<Self>) -> FloatTensor<Self> {
        by_type!(tensor, F => Self::from_host(Self::host::<F>(tensor.clone()).to_vec(), &tensor.shape(), &tensor))
    }

    fn host_ints(tensor: IntTensor<Self>) -> Host<i32> {
        match tensor {
            NdArrayTensor::I32(storage) => Host::Copied(storage.view().iter().copied().collect()),
            NdArrayTensor::I64(storage) => narrowed(storage.view().iter()),
            other => unreachable!("the type is checked where tensors enter: {:?}", other.dtype()),
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

fn check_type<F: Real>(dtype: DType) {
    assert_eq!(dtype, F::DTYPE, "all tensors of a stage share one float type; the public functions check it");
}

pub(crate) use by_type;
