//! Copies from a device to the host.

use burn::tensor::kind::Basic;
use burn::tensor::{Tensor, TensorData};

use crate::counters::count_read;

/// Copies the elements of a tensor to the host, row-major, and waits for its device. Tests count the bytes.
pub fn read_back<const D: usize, K: Basic>(tensor: Tensor<D, K>) -> TensorData {
    let data = tensor.into_data();
    count_read(data.as_bytes().len() as u64);
    data
}
