//! Copies of values between the host and a device.

use burn::tensor::{DType, Device, Tensor, TensorData};

/// Values of a tensor on the host. A row belongs to one Gaussian or one pixel.
#[derive(Clone, Debug)]
pub struct Named {
    pub name: &'static str,
    pub columns: usize,
    pub values: Vec<f64>,
}

/// Creates a tensor of the given values and type.
pub fn tensor<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), (device, dtype))
}

/// Creates a tensor as [`tensor`] does, tracked if the device records gradients.
pub fn leaf<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    let tensor = tensor(values, shape, device, dtype);
    if device.is_autodiff() { tensor.require_grad() } else { tensor }
}

/// Copies a tensor's values to the host. The conversion of f32 values is exact.
pub fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().iter::<f64>().collect()
}
