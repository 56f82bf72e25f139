//! Features of a GPU that the kernels use, for programs that report them to their users.

use burn::backend::DispatchDevice;
use burn::tensor::Device;

use crate::gpu::Gpu;

/// Optional features of a device. The kernels use each one if the device supports it and a fallback if it does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Abilities {
    /// Whether plane (subgroup, warp) operations are supported. The fallback is shared memory.
    pub planes: bool,
    /// Whether atomic addition of f32 is supported. The fallback exchanges the bits atomically.
    pub float_atomics: bool,
}

impl Abilities {
    /// Returns the features of a GPU, which is opened if necessary; `None` for a CPU device.
    ///
    /// # Panics
    /// If the driver cannot open the device.
    pub fn of(device: &Device) -> Option<Self> {
        gpu(device).map(|Gpu { planes, float_atomics, .. }| Self { planes, float_atomics })
    }
}

/// Returns the launches' handle of a GPU, which is opened if necessary; `None` for a CPU device.
pub(crate) fn gpu(device: &Device) -> Option<Gpu> {
    match device.clone().inner().as_dispatch() {
        DispatchDevice::Cube(device) => Some(Gpu::new(&device.client())),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cpu_device_has_none() {
        assert_eq!(Abilities::of(&Device::flex()), None);
        assert_eq!(Abilities::of(&Device::flex().autodiff()), None);
    }
}
