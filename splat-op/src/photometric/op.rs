//! The operations as an extension of Burn's GPU backend. The loss is its own derivative's source, so no backward node is
//! needed: whoever calls attaches the derivative.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::{DType, Tensor};
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

use super::launch::{DeviceInputs, launch_photometric, launch_window};
use crate::bind::cube::{buffer, tensor};
use crate::gpu::Gpu;
use crate::op::Slot;

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
    /// Each value's share of the loss; their sum is the loss.
    pub shares: FloatTensor<B>,
    /// The derivative of the loss with respect to the picture, if asked for.
    #[extension_type]
    pub gradient: Slot<B>,
}

/// The operations of this module, on GPU backends alone.
#[backend_extension(Cube, Fusion: cfg(feature = "fusion"))]
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
fn picture_size(tensor: &CubeTensor) -> [usize; 2] {
    let shape = tensor.shape();
    let rank = shape.num_dims();
    [shape[rank - 1], shape[rank - 2]]
}

impl PhotometricBackend for CubeBackend {
    fn photometric(inputs: PhotometricInputs<Self>, lambda: f64, with_gradient: bool) -> Photometric<Self> {
        let like = inputs.image.clone();
        let gpu = Gpu::new(&like.client);
        let [width, height] = picture_size(&like);
        let on_device = DeviceInputs {
            image: buffer(inputs.image),
            truth: buffer(inputs.truth),
            mean: buffer(inputs.mean),
            variance: buffer(inputs.variance),
        };
        let (shares, gradient) = launch_photometric(&gpu, &on_device, [width, height], lambda, with_gradient);
        let picture = |found| tensor(found, like.shape(), DType::F32, &like);
        Photometric { shares: picture(shares), gradient: gradient.map_or(Slot::Skip, |g| Slot::Have(picture(g))) }
    }

    fn window(planes: FloatTensor<Self>) -> FloatTensor<Self> {
        let gpu = Gpu::new(&planes.client);
        let [width, height] = picture_size(&planes);
        let filtered = launch_window(&gpu, &buffer(planes.clone()), [width, height]);
        tensor(filtered, planes.shape(), DType::F32, &planes)
    }

    fn contiguous(planes: FloatTensor<Self>) -> FloatTensor<Self> {
        into_contiguous(planes)
    }
}

/// See [`super::photometric()`].
pub(super) fn photometric<const D: usize>(
    image: &Tensor<D>,
    [truth, mean, variance]: [&Tensor<D>; 3],
    lambda: f64,
    with_gradient: bool,
) -> (Tensor<D>, Option<Tensor<D>>) {
    let [image, truth, mean, variance] = [image, truth, mean, variance].map(|t| t.clone().into_dispatch());
    let inputs = PhotometricInputs { image, truth, mean, variance };
    let found = <Dispatch as PhotometricBackend>::photometric(inputs, lambda, with_gradient);
    let gradient = match found.gradient {
        Slot::Have(gradient) => Some(Tensor::from_dispatch(gradient)),
        Slot::Skip => None,
    };
    (Tensor::from_dispatch(found.shares), gradient)
}

/// See [`super::window()`].
pub(super) fn window<const D: usize>(planes: &Tensor<D>) -> Tensor<D> {
    Tensor::from_dispatch(<Dispatch as PhotometricBackend>::window(planes.clone().into_dispatch()))
}

/// See [`super::contiguous()`].
pub(super) fn contiguous<const D: usize>(planes: &Tensor<D>) -> Tensor<D> {
    Tensor::from_dispatch(<Dispatch as PhotometricBackend>::contiguous(planes.clone().into_dispatch()))
}
