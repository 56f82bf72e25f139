//! Counters and switches for tests. Not part of the public interface.

use std::sync::atomic::{AtomicU64, Ordering};

use burn::backend::{Backend, Dispatch};
use burn::tensor::Device;

static DISPATCHES: AtomicU64 = AtomicU64::new(0);
static TWIN_CALLS: AtomicU64 = AtomicU64::new(0);
static ALLOCATED: AtomicU64 = AtomicU64::new(0);

/// Returns the number of kernels of this crate that this process has launched so far, on all GPUs.
pub fn dispatches() -> u64 {
    DISPATCHES.load(Ordering::Relaxed)
}

/// Returns the bytes of all GPU buffers that the operations of this crate have allocated so far, without Burn's own.
pub fn allocated_bytes() -> u64 {
    ALLOCATED.load(Ordering::Relaxed)
}

/// Runs `work` and returns the number of launches of each kernel by name, including Burn's. `work` must wait for its results.
#[cfg(feature = "cube")]
pub fn launches(work: impl FnOnce()) -> std::collections::BTreeMap<&'static str, usize> {
    use std::collections::BTreeMap;
    use std::sync::{Arc, Mutex, PoisonError};

    use cubecl::logging::{LaunchObservation, LaunchObserver};

    #[derive(Default)]
    struct Counts(Mutex<BTreeMap<&'static str, usize>>);

    impl LaunchObserver for Counts {
        fn launched(&self, kernel: &'static str) {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(kernel).or_default() += 1;
        }
    }

    let counts = Arc::new(Counts::default());
    let observation = LaunchObservation::new(counts.clone());
    work();
    drop(observation);
    let counts = counts.0.lock().unwrap_or_else(PoisonError::into_inner);
    counts.clone()
}

/// Returns the number of stages that this process has computed on the CPU so far, forward and backward.
pub fn twin_calls() -> u64 {
    TWIN_CALLS.load(Ordering::Relaxed)
}

/// Returns Burn's name of a device's backend, including its wrappers.
pub fn backend_name(device: &Device) -> String {
    Dispatch::name(device.as_dispatch())
}

/// Returns the size of a GPU's largest buffer, bytes; `None` for a CPU device.
pub fn buffer_limit(device: &Device) -> Option<u64> {
    crate::limits::buffer_limit(device)
}

/// Sets whether every new buffer of the kernels is filled with the bits of NaN, so that tests find slots that no kernel wrote.
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

#[cfg(feature = "cube")]
pub(crate) fn count_allocation(bytes: u64) {
    ALLOCATED.fetch_add(bytes, Ordering::Relaxed);
}

pub(crate) fn count_twin_call() {
    TWIN_CALLS.fetch_add(1, Ordering::Relaxed);
}
