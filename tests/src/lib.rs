//! What the tests of several crates share: scenes on the host, their render and gradients on any device and float type,
//! the reference vectors, and comparisons.

pub mod band;
pub mod compare;
pub mod dense;
mod devices;
pub mod perturb;
#[path = "../../splat-op/src/testing/random.rs"]
pub mod random;
pub mod reference;
pub mod scene;
pub mod tracked;

pub use devices::{cpu_devices, devices, gpu, ndarray};
