//! Values between the host and a device.

use burn::tensor::{DType, Device, Tensor, TensorData};

/// A tensor's values on the host. Rows are what belongs to one Gaussian or one pixel.
#[derive(Clone, Debug)]
pub struct Named {
    pub name: &'static str,
    pub columns: usize,
    pub values: Vec<f64>,
}

/// A tensor of the given values and type.
pub fn tensor<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), (device, dtype))
}

/// As [`tensor`]; a tracked leaf if the device records gradients.
pub fn leaf<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    let tensor = tensor(values, shape, device, dtype);
    if device.is_autodiff() { tensor.require_grad() } else { tensor }
}

/// A tensor's values; of f32 ones the exact equals.
pub fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().iter::<f64>().collect()
}
