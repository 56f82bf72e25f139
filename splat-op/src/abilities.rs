//! Features and limits of a device.

#[cfg(feature = "cube")]
use burn::backend::DispatchDevice;
use burn::tensor::Device;

use crate::error::Result;
#[cfg(feature = "cube")]
use crate::gpu::Gpu;
use crate::limits::{Need, lowered_limit};

/// Optional features of a device. The kernels use each one if the device supports it and a fallback if it does not.
#[cfg(feature = "cube")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Abilities {
    /// Whether atomic addition of f32 is supported. The fallback exchanges the bits atomically.
    pub float_atomics: bool,
}

#[cfg(feature = "cube")]
impl Abilities {
    /// Returns the features of a GPU, which is opened if necessary; `None` for a CPU device.
    ///
    /// # Panics
    /// If the driver cannot open the device.
    pub fn of(device: &Device) -> Option<Self> {
        gpu(device).map(|Gpu { float_atomics, .. }| Self { float_atomics })
    }
}

/// Returns the launches' handle of a GPU, which is opened if necessary; `None` for a CPU device.
#[cfg(feature = "cube")]
pub(crate) fn gpu(device: &Device) -> Option<Gpu> {
    match device.clone().inner().as_dispatch() {
        DispatchDevice::Cube(device) => Some(Gpu::new(&device.client())),
        _ => None,
    }
}

/// Refuses a call that needs more than a GPU's largest buffer. CPUs have no limit but their memory.
pub(crate) fn check_fits(device: &Device, needs: &[Need]) -> Result<()> {
    match buffer_limit(device) {
        Some(limit) => needs.iter().try_for_each(|need| need.check(limit)),
        None => Ok(()),
    }
}

/// Returns whether a device is a GPU, which computes asynchronously.
pub fn is_gpu(device: &Device) -> bool {
    buffer_limit(device).is_some()
}

/// Returns the size of the largest tensor that kernels can use on a device, bytes: that of a GPU's largest buffer. CPUs have no
/// limit but their memory.
pub fn largest_tensor(device: &Device) -> u64 {
    buffer_limit(device).unwrap_or_else(lowered_limit)
}

/// Size of a GPU's largest buffer, bytes; `None` for a CPU device.
#[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "no GPU runtime is compiled in"))]
pub fn buffer_limit(device: &Device) -> Option<u64> {
    #[cfg(feature = "cube")]
    return gpu(device).map(|gpu| gpu.buffer_limit);
    #[cfg(not(feature = "cube"))]
    None
}

#[cfg(test)]
mod tests;
