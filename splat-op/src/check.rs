//! Checks of input tensors: shape, float type and device.

use std::fmt::Display;

use burn::tensor::{DType, Device, Tensor, TensorCreationOptions};

use crate::abilities::{buffer_limit, check_fits};
use crate::error::{Result, SplatError};
use crate::limits::Need;

/// The float type and device that all tensors of a call must share.
pub(crate) struct Reference {
    dtype: DType,
    device: Device,
}

impl Reference {
    /// Takes the float type and device of `tensor`. The type must be supported by the device.
    pub fn new<const D: usize>(name: &'static str, tensor: &Tensor<D>) -> Result<Self> {
        let dtype = tensor.dtype();
        let device = tensor.device();
        match dtype {
            DType::F64 if buffer_limit(&device).is_some() => {
                let expected = "F32, the float type of GPUs (move tensors to a CPU device for F64)".into();
                Err(SplatError::DType { name, found: "F64".into(), expected })
            }
            DType::F32 | DType::F64 => Ok(Self { dtype, device }),
            _ => Err(SplatError::DType { name, found: format!("{dtype:?}"), expected: "F32 or F64".into() }),
        }
    }

    /// Options that create a tensor with this type on this device.
    pub fn options(&self) -> TensorCreationOptions {
        (&self.device, self.dtype).into()
    }

    /// Compares a tensor with the reference and with `shape`, in which `None` is free.
    pub fn check<const D: usize>(
        &self,
        name: &'static str,
        tensor: &Tensor<D>,
        shape: [Option<usize>; D],
        expected: &'static str,
    ) -> Result<()> {
        let dims = tensor.dims();
        if let Some(axis) = (0..D).find(|&axis| shape[axis].is_some_and(|size| size != dims[axis])) {
            let size = shape[axis].unwrap_or_default();
            return Err(SplatError::Shape {
                name,
                found: dims.to_vec(),
                expected,
                hint: format!("dimension {axis} must be {size}"),
            });
        }
        let dtype = tensor.dtype();
        if dtype != self.dtype {
            let (found, expected) = (format!("{dtype:?}"), format!("{:?}", self.dtype));
            return Err(SplatError::DType { name, found, expected });
        }
        self.check_device(name, &tensor.device())
    }

    /// Refuses needs that do not fit into the device's buffers.
    pub fn check_fits(&self, needs: &[Need]) -> Result<()> {
        check_fits(&self.device, needs)
    }

    /// Compares a device with the reference, regardless of gradient tracking: constants and tracked tensors may be mixed.
    pub fn check_device(&self, name: &'static str, device: &Device) -> Result<()> {
        let (found, expected) = (device.clone().without_autodiff(), self.device.clone().without_autodiff());
        if found != expected {
            return Err(SplatError::Device { name, found: format!("{found:?}"), expected: format!("{expected:?}") });
        }
        Ok(())
    }
}

/// Refuses a value that is not `ok`.
pub(crate) fn check_value(field: &'static str, ok: bool, found: impl Display, expected: &'static str) -> Result<()> {
    match ok {
        true => Ok(()),
        false => Err(SplatError::Value { field, found: found.to_string(), expected }),
    }
}
