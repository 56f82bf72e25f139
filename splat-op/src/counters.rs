//! Counts of launches, allocations and CPU stages of this process, for tests.

use std::sync::atomic::{AtomicU64, Ordering};

static DISPATCHES: AtomicU64 = AtomicU64::new(0);
static TWIN_CALLS: AtomicU64 = AtomicU64::new(0);
static ALLOCATED: AtomicU64 = AtomicU64::new(0);
static BOUND: AtomicU64 = AtomicU64::new(0);

/// Returns the number of kernels of this crate that this process has launched so far, on all GPUs.
pub fn dispatches() -> u64 {
    DISPATCHES.load(Ordering::Relaxed)
}

/// Returns the bytes of all GPU buffers that the operations of this crate have allocated so far, without Burn's own.
pub fn allocated_bytes() -> u64 {
    ALLOCATED.load(Ordering::Relaxed)
}

/// Returns the bytes of all buffers that the kernels of this crate have been launched with so far, each counted at every launch:
/// what the kernels would move if each read or wrote all of its buffers once.
pub fn bound_bytes() -> u64 {
    BOUND.load(Ordering::Relaxed)
}

/// Returns the number of stages that this process has computed on the CPU so far, forward and backward.
pub fn twin_calls() -> u64 {
    TWIN_CALLS.load(Ordering::Relaxed)
}

#[cfg(feature = "cube")]
pub(crate) fn count_dispatch() {
    DISPATCHES.fetch_add(1, Ordering::Relaxed);
}

#[cfg(feature = "cube")]
pub(crate) fn count_allocation(bytes: u64) {
    ALLOCATED.fetch_add(bytes, Ordering::Relaxed);
}

#[cfg(feature = "cube")]
pub(crate) fn count_binding(bytes: u64) {
    BOUND.fetch_add(bytes, Ordering::Relaxed);
}

pub(crate) fn count_twin_call() {
    TWIN_CALLS.fetch_add(1, Ordering::Relaxed);
}
