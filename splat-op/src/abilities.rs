//! What the kernels find on a GPU, for programs that tell their users.

use burn::backend::DispatchDevice;
use burn::tensor::Device;

use crate::gpu::Gpu;

/// What a device can do of that which the kernels use where it is there, and do without where it is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Abilities {
    /// Units of a plane (subgroup, warp) can compute together; else they go through shared memory.
    pub planes: bool,
    /// f32 can be added atomically; else by exchanging its bits.
    pub float_atomics: bool,
}

impl Abilities {
    /// Those of a GPU, which is opened for it if it was not yet; `None` for a CPU device.
    ///
    /// # Panics
    /// If the driver does not open the device.
    pub fn of(device: &Device) -> Option<Self> {
        gpu(device).map(|Gpu { planes, float_atomics, .. }| Self { planes, float_atomics })
    }
}

/// As the launches see a device, which is opened for it if it was not yet; `None` for a CPU device.
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
