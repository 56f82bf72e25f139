//! Code shared by the tests of several crates: scenes on the host, their render and gradients on any device and float type,
//! the reference vectors, and comparisons.

pub mod band;
pub mod data;
pub mod dense;
mod devices;
pub mod lenses;
pub mod perturb;
pub mod reference;
pub mod scene;
pub mod slope;
pub mod tracked;

pub use devices::{cpu_devices, devices, gpu, ndarray, places};
pub use splat_hard_cases::{compare, random};
