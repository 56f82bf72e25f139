//! The operations as an extension of Burn's backends. The loss is its own derivative's source, so no backward node is
//! needed: whoever calls attaches the derivative.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, Flex, NdArray, TensorMetadata, backend_extension};
use burn::tensor::{DType, Shape, Tensor};

use super::cpu::{self, Size, photometric_cpu, window_cpu};
use crate::bind::host::HostBackend;
use crate::op::Slot;
use crate::real::Real;
use crate::witness::count_twin_call;

/// A photograph with what the loss needs of it, and the picture to compare.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct PhotometricInputs<B: Backend> {
    /// The picture.
    pub image: FloatTensor<B>,
    /// The photograph.
    pub truth: FloatTensor<B>,
    /// `μy` of the photograph.
    pub mean: FloatTensor<B>,
    /// `σy² + C2` of the photograph.
    pub variance: FloatTensor<B>,
}

/// The loss and its derivative.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct Photometric<B: Backend> {
    /// Numbers whose sum is the loss, of the rank of the picture: one on a CPU, one for each value on a GPU.
    pub shares: FloatTensor<B>,
    /// The derivative of the loss with respect to the picture, if asked for.
    #[extension_type]
    pub gradient: Slot<B>,
}

/// The operations of this module, on backends without autodiff.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Fusion: cfg(feature = "fusion"))]
pub trait PhotometricBackend: Backend {
    /// `(1 − λ) |x − y| + λ (1 − S)`, divided by the number of values, and its derivative.
    #[fusion(meta = photometric_meta)]
    fn photometric(
        #[extension_type] inputs: PhotometricInputs<Self>,
        lambda: f64,
        with_gradient: bool,
    ) -> Photometric<Self>;

    /// `Kx`, of any number of planes.
    #[fusion(dtype = planes, shape = planes)]
    fn window(planes: FloatTensor<Self>) -> FloatTensor<Self>;

    /// The same values in contiguous memory.
    #[fusion(dtype = planes, shape = planes)]
    fn contiguous(planes: FloatTensor<Self>) -> FloatTensor<Self>;
}

#[cfg(feature = "fusion")]
fn photometric_meta(inputs: &PhotometricInputsMetadata, _: &f64, with_gradient: &bool) -> PhotometricMetadata {
    let gradient = match with_gradient {
        true => crate::op::SlotMetadata::Have(inputs.image.clone()),
        false => crate::op::SlotMetadata::Skip,
    };
    PhotometricMetadata { shares: inputs.image.clone(), gradient }
}

/// Width and height: the last two dimensions, the other way round.
fn picture_size(shape: &Shape) -> [usize; 2] {
    let rank = shape.num_dims();
    [shape[rank - 1], shape[rank - 2]]
}

fn plane_size(shape: &Shape) -> Size {
    let [width, height] = picture_size(shape);
    Size { width, height }
}

fn photometric_host<B: HostBackend, F: Real>(
    inputs: PhotometricInputs<B>,
    lambda: f64,
    with_gradient: bool,
) -> Photometric<B> {
    count_twin_call();
    let like = inputs.image.clone();
    let PhotometricInputs { image, truth, mean, variance } = inputs;
    let host = [image, truth, mean, variance].map(B::host::<F>);
    let [image, truth, mean, variance] = &host;
    let shape = like.shape();
    let (loss, gradient) =
        photometric_cpu(cpu::Inputs { image, truth, mean, variance }, plane_size(&shape), lambda, with_gradient);
    Photometric {
        shares: B::from_host(vec![loss], &vec![1; shape.num_dims()], &like),
        gradient: gradient.map_or(Slot::Skip, |gradient| Slot::Have(B::from_host(gradient, &shape, &like))),
    }
}

fn window_host<B: HostBackend, F: Real>(planes: FloatTensor<B>) -> FloatTensor<B> {
    count_twin_call();
    let shape = planes.shape();
    let filtered = window_cpu::<F>(&B::host(planes.clone()), plane_size(&shape));
    B::from_host(filtered, &shape, &planes)
}

fn contiguous_host<B: HostBackend, F: Real>(planes: FloatTensor<B>) -> FloatTensor<B> {
    let values = B::host::<F>(planes.clone()).to_vec();
    B::from_host(values, &planes.shape(), &planes)
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl PhotometricBackend for $backend {
            fn photometric(inputs: PhotometricInputs<Self>, lambda: f64, with_gradient: bool) -> Photometric<Self> {
                match inputs.image.dtype() {
                    DType::F64 => photometric_host::<Self, f64>(inputs, lambda, with_gradient),
                    _ => photometric_host::<Self, f32>(inputs, lambda, with_gradient),
                }
            }

            fn window(planes: FloatTensor<Self>) -> FloatTensor<Self> {
                match planes.dtype() {
                    DType::F64 => window_host::<Self, f64>(planes),
                    _ => window_host::<Self, f32>(planes),
                }
            }

            fn contiguous(planes: FloatTensor<Self>) -> FloatTensor<Self> {
                match planes.dtype() {
                    DType::F64 => contiguous_host::<Self, f64>(planes),
                    _ => contiguous_host::<Self, f32>(planes),
                }
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
    use crate::bind::cube::{buffer, tensor};
    use crate::gpu::Gpu;
    use crate::photometric::launch::{DeviceInputs, launch_photometric, launch_window};

    impl PhotometricBackend for CubeBackend {
        fn photometric(inputs: PhotometricInputs<Self>, lambda: f64, with_gradient: bool) -> Photometric<Self> {
            let like = inputs.image.clone();
            let gpu = Gpu::new(&like.client);
            let size = picture_size(&like.shape());
            let on_device = DeviceInputs {
                image: buffer(inputs.image),
                truth: buffer(inputs.truth),
                mean: buffer(inputs.mean),
                variance: buffer(inputs.variance),
            };
            let (shares, gradient) = launch_photometric(&gpu, &on_device, size, lambda, with_gradient);
            let picture = |found| tensor(found, like.shape(), DType::F32, &like);
            Photometric { shares: picture(shares), gradient: gradient.map_or(Slot::Skip, |g| Slot::Have(picture(g))) }
        }

        fn window(planes: FloatTensor<Self>) -> FloatTensor<Self> {
            let gpu = Gpu::new(&planes.client);
            let filtered = launch_window(&gpu, &buffer(planes.clone()), picture_size(&planes.shape()));
            tensor(filtered, planes.shape(), DType::F32, &planes)
        }

        fn contiguous(planes: FloatTensor<Self>) -> FloatTensor<Self> {
            into_contiguous(planes)
        }
    }
}

/// The loss of `image` against a photograph, `[.., H, W]` f32, or f64 on CPUs, without autodiff: numbers whose sum it is, and
/// its derivative if asked for.
///
/// The photograph is given by itself, its mean `μy` and its variance `σy² + C2`, all of the shape of the picture; `lambda`
/// weighs the dissimilarity.
///
/// # Panics
/// If the shapes differ, or the float type is another.
pub fn photometric<const D: usize>(
    image: &Tensor<D>,
    photograph: [&Tensor<D>; 3],
    lambda: f64,
    with_gradient: bool,
) -> (Tensor<D>, Option<Tensor<D>>) {
    for tensor in [image, photograph[0], photograph[1], photograph[2]] {
        check(tensor);
        assert_eq!(tensor.dims(), image.dims(), "a picture and its photograph have one shape");
        assert_eq!(tensor.dtype(), image.dtype(), "a picture and its photograph have one float type");
    }
    let [truth, mean, variance] = photograph.map(|t| t.clone().into_dispatch());
    let inputs = PhotometricInputs { image: image.clone().into_dispatch(), truth, mean, variance };
    let found = <Dispatch as PhotometricBackend>::photometric(inputs, lambda, with_gradient);
    let gradient = match found.gradient {
        Slot::Have(gradient) => Some(Tensor::from_dispatch(gradient)),
        Slot::Skip => None,
    };
    (Tensor::from_dispatch(found.shares), gradient)
}

/// `Kx` of planes `[.., H, W]` f32, or f64 on CPUs, without autodiff.
///
/// # Panics
/// If the float type is another.
pub fn window<const D: usize>(planes: &Tensor<D>) -> Tensor<D> {
    check(planes);
    Tensor::from_dispatch(<Dispatch as PhotometricBackend>::window(planes.clone().into_dispatch()))
}

fn check<const D: usize>(tensor: &Tensor<D>) {
    assert!(D >= 2, "a picture has rows and columns, found {D} dimension");
    let dtype = tensor.dtype();
    assert!(
        dtype == DType::F32 || dtype == DType::F64 && !crate::is_gpu(&tensor.device()),
        "pictures are f32, or f64 on a CPU; found {dtype:?}"
    );
}

/// The same planes, one after the other in memory: what is read at every step should not be put in order at every step.
///
/// # Panics
/// If the float type is another than those of [`window`].
pub fn contiguous<const D: usize>(planes: &Tensor<D>) -> Tensor<D> {
    check(planes);
    Tensor::from_dispatch(<Dispatch as PhotometricBackend>::contiguous(planes.clone().into_dispatch()))
}
