//! What tests may ask of the operation and users have no use for. No part of the public interface.

use std::sync::atomic::{AtomicU64, Ordering};

use burn::backend::{Backend, Dispatch};
use burn::tensor::Device;

static DISPATCHES: AtomicU64 = AtomicU64::new(0);
static TWIN_CALLS: AtomicU64 = AtomicU64::new(0);

/// Kernels that this process has launched so far, on any GPU.
pub fn dispatches() -> u64 {
    DISPATCHES.load(Ordering::Relaxed)
}

/// Stages that this process has computed on the CPU so far, forward or backward.
pub fn twin_calls() -> u64 {
    TWIN_CALLS.load(Ordering::Relaxed)
}

/// Burn's name of the backend that a device leads to, with what is wrapped around it.
pub fn backend_name(device: &Device) -> String {
    Dispatch::name(device.as_dispatch())
}

/// The bytes of a GPU's largest buffer; `None` for a CPU device.
pub fn buffer_limit(device: &Device) -> Option<u64> {
    crate::limits::buffer_limit(device)
}

/// From now on, fill every new buffer of the kernels with the bits of NaN, so that a slot nobody wrote shows.
pub fn poison(on: bool) {
    #[cfg(feature = "cube")]
    crate::gpu::poison(on);
    #[cfg(not(feature = "cube"))]
    let _ = on;
}

#[cfg(feature = "cube")]
pub(crate) fn count_dispatch() {
    DISPATCHES.fetch_add(1, Ordering::Relaxed);
}

pub(crate) fn count_twin_call() {
    TWIN_CALLS.fetch_add(1, Ordering::Relaxed);
}
