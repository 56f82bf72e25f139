//! The photometric loss as an extension of Burn's backends. Its derivative is computed with it, so no backward node is needed:
//! the caller attaches the derivative.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, ExtensionType, Flex, NdArray, TensorMetadata, backend_extension};
use burn::tensor::{DType, Shape};

use super::cpu::host;
#[cfg(feature = "fusion")]
use super::fusion::float;
use super::host::HostBackend;
use super::tensors::{ComparedTensors, OptionalTensor};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::counters::count_twin_call;
use crate::loss::cpu::{PlaneSize, moments_cpu, photometric_cpu};
#[cfg(feature = "fusion")]
use crate::loss::taps::Compared;
use crate::simd::real::Real;

/// The loss and its derivative.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct Photometric<B: Backend> {
    /// `[1]`: the loss.
    pub loss: FloatTensor<B>,
    /// The derivative of the loss with respect to the picture, if asked for.
    #[extension_type]
    pub gradient: OptionalTensor<B>,
}

/// What the loss needs of a photograph besides its planes, each of their shape.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct PhotographMoments<B: Backend> {
    /// `μy`
    pub mean: FloatTensor<B>,
    /// `σy² + C2`
    pub variance: FloatTensor<B>,
}

/// The photometric loss, on backends without autodiff; see `loss/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Fusion: cfg(feature = "fusion"))]
pub trait PhotometricBackend: Backend {
    /// Returns `(1 − λ) |x − y| + λ (1 − S)`, divided by the number of values, and its derivative.
    #[fusion(meta = photometric_meta)]
    fn photometric(
        #[extension_type] inputs: ComparedTensors<Self>,
        lambda: f64,
        with_gradient: bool,
    ) -> Photometric<Self>;

    /// Returns the moments of a photograph's planes.
    #[fusion(meta = |planes| PhotographMomentsMetadata { mean: planes.clone(), variance: planes.clone() })]
    fn moments(planes: FloatTensor<Self>) -> PhotographMoments<Self>;

    /// Returns the same values in contiguous memory.
    #[fusion(dtype = planes, shape = planes)]
    fn contiguous(planes: FloatTensor<Self>) -> FloatTensor<Self>;
}

#[cfg(feature = "fusion")]
fn photometric_meta(inputs: &Compared<InputTensorMetadata>, _: &f64, with_gradient: &bool) -> PhotometricMetadata {
    let gradient = match with_gradient {
        true => OptionalTensorMetadata::Present(inputs.image.0.clone()),
        false => OptionalTensorMetadata::Absent,
    };
    PhotometricMetadata { loss: float([1], &inputs.image.0), gradient }
}

/// Returns width and height, which are the last two dimensions in reverse order.
fn picture_size(shape: &Shape) -> [usize; 2] {
    let rank = shape.num_dims();
    [shape[rank - 1], shape[rank - 2]]
}

fn plane_size(shape: &Shape) -> PlaneSize {
    let [width, height] = picture_size(shape);
    PlaneSize { width, height }
}

fn photometric_host<B: HostBackend, F: Real>(
    inputs: ComparedTensors<B>,
    lambda: f64,
    with_gradient: bool,
) -> Photometric<B> {
    count_twin_call();
    let like = &inputs.image.0;
    let read = inputs.each_ref().map(host::<B, F>);
    let (shape, slices) = (like.shape(), read.each_ref().map(|host| &host[..]));
    let (loss, gradient) = photometric_cpu(slices, plane_size(&shape), lambda, with_gradient);
    Photometric {
        loss: B::from_host(vec![loss], &[1], like),
        gradient: gradient.map(|gradient| B::from_host(gradient, &shape, like)).into(),
    }
}

fn moments_host<B: HostBackend, F: Real>(planes: FloatTensor<B>) -> PhotographMoments<B> {
    count_twin_call();
    let shape = planes.shape();
    let found = moments_cpu::<F>(&B::host(planes.clone()), plane_size(&shape));
    let [mean, variance] = found.map(|values| B::from_host(values, &shape, &planes));
    PhotographMoments { mean, variance }
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl PhotometricBackend for $backend {
            fn photometric(inputs: ComparedTensors<Self>, lambda: f64, with_gradient: bool) -> Photometric<Self> {
                match inputs.image.0.dtype() {
                    DType::F64 => photometric_host::<Self, f64>(inputs, lambda, with_gradient),
                    _ => photometric_host::<Self, f32>(inputs, lambda, with_gradient),
                }
            }

            fn moments(planes: FloatTensor<Self>) -> PhotographMoments<Self> {
                match planes.dtype() {
                    DType::F64 => moments_host::<Self, f64>(planes),
                    _ => moments_host::<Self, f32>(planes),
                }
            }

            fn contiguous(planes: FloatTensor<Self>) -> FloatTensor<Self> {
                <Self as HostBackend>::contiguous(planes)
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);

#[cfg(feature = "cube")]
mod gpu {
    use burn_cubecl::CubeBackend;
    use burn_cubecl::kernel::into_contiguous;

    use super::*;
    use crate::backend::cube::{buffer, on_device, tensor};
    use crate::gpu::Gpu;
    use crate::loss::launch::{launch_moments, launch_photometric};

    impl PhotometricBackend for CubeBackend {
        fn photometric(inputs: ComparedTensors<Self>, lambda: f64, with_gradient: bool) -> Photometric<Self> {
            let like = &inputs.image.0;
            let (gpu, size) = (Gpu::new(&like.client), picture_size(&like.shape()));
            let on_device = inputs.each_ref().map(on_device);
            let (loss, gradient) = launch_photometric(&gpu, &on_device, size, lambda, with_gradient);
            let gradient = gradient.map(|found| tensor(found, like.shape(), DType::F32, like));
            Photometric { loss: tensor(loss, [1], DType::F32, like), gradient: gradient.into() }
        }

        fn moments(planes: FloatTensor<Self>) -> PhotographMoments<Self> {
            let gpu = Gpu::new(&planes.client);
            let found = launch_moments(&gpu, &buffer(planes.clone()), picture_size(&planes.shape()));
            let [mean, variance] = found.map(|values| tensor(values, planes.shape(), DType::F32, &planes));
            PhotographMoments { mean, variance }
        }

        fn contiguous(planes: FloatTensor<Self>) -> FloatTensor<Self> {
            into_contiguous(planes)
        }
    }
}
