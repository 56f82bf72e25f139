//! Shared code of the benches: scenes, their counted load, lower limits of the time of each pass, and the measurement of
//! times.

pub mod allocations;
pub mod counts;
pub mod job;
pub mod limit;
mod load;
pub mod measure;
pub mod passes;
pub mod pieces;
pub mod random;
mod scene;
pub mod step;

pub use load::Load;
pub use scene::{HUGE, LARGE, MEDIUM, SMALL, SyntheticView, TINY, WIDE};

use burn::tensor::Tensor;

/// Returns all elements as f64, row-major.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().convert::<f64>().try_into_vec().expect("converted in this line")
}

/// Returns the share of elements that differ by more than `tolerance`. NaN counts as different.
pub fn share_apart(found: &[f64], expected: &[f64], tolerance: f64) -> f64 {
    assert_eq!(found.len(), expected.len());
    let apart = found.iter().zip(expected).filter(|(a, b)| !((*a - *b).abs() <= tolerance)).count();
    apart as f64 / found.len() as f64
}
