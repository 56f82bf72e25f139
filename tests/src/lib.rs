//! What the tests of several crates share: scenes on the host, their render and gradients on any device and float type,
//! the reference vectors, and comparisons.

pub mod band;
pub mod compare;
pub mod dense;
pub mod perturb;
#[path = "../../splat-op/src/testing/random.rs"]
pub mod random;
pub mod reference;
pub mod scene;

use burn::tensor::Device;

/// The CPU devices that every proof runs on.
pub fn devices() -> [(&'static str, Device); 2] {
    [("flex", Device::flex()), ("ndarray", ndarray())]
}

/// The device of the backend that this project was asked to support beside Flex.
#[allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]
pub fn ndarray() -> Device {
    Device::ndarray()
}
