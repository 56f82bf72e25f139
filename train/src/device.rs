//! Devices by name.

use burn::tensor::Device;
use clap::ValueEnum;

/// Where to compute, as the command line names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DeviceName {
    /// The fastest there is; today always `cpu`
    #[default]
    Auto,
    /// The faster of the CPU backends: `flex`
    Cpu,
    /// Burn's CPU backend
    Flex,
    /// Burn's older CPU backend, deprecated by Burn
    Ndarray,
}

impl DeviceName {
    /// The device, and the name of its backend.
    pub fn resolve(self) -> (Device, &'static str) {
        match self {
            Self::Auto | Self::Cpu | Self::Flex => (Device::flex(), "flex"),
            Self::Ndarray => (ndarray(), "ndarray"),
        }
    }
}

#[allow(deprecated, reason = "Burn still releases it, and this project supports it for comparison with flex")]
fn ndarray() -> Device {
    Device::ndarray()
}
