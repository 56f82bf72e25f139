//! Counters and switches for tests. Not part of the public interface.

use std::collections::BTreeMap;

use burn::backend::{Backend, Dispatch};
use burn::tensor::Device;

pub use crate::abilities::{buffer_limit, lower_limit};
#[cfg(feature = "cube")]
pub use crate::counters::{PairCounts, count_pairs};
pub use crate::counters::{
    allocated_bytes, bound_bytes, dispatches, expect_intersections, idle_waits, read_bytes, repeated_lists, twin_calls,
};
#[cfg(feature = "cube")]
pub use crate::gpu::poison;

/// Returns the numbers of pairs of a view on a GPU, from the trace of a render under [`count_pairs`]. Waits for the device.
#[cfg(feature = "cube")]
pub fn pair_counts(device: &Device, trace: &crate::backend::TraceCell) -> Option<PairCounts> {
    let trace = trace.0.get()?.downcast_ref::<crate::rasterize::trace::DeviceTrace>()?;
    trace.pair_counts(&crate::abilities::gpu(device)?)
}

/// Runs `work`. There are no kernels to count.
#[cfg(not(feature = "cube"))]
pub fn launches(work: impl FnOnce()) -> BTreeMap<&'static str, usize> {
    work();
    BTreeMap::new()
}

/// Runs `work` and returns the number of launches of each kernel by name, including Burn's. `work` must wait for its results.
#[cfg(feature = "cube")]
pub fn launches(work: impl FnOnce()) -> BTreeMap<&'static str, usize> {
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

/// Returns Burn's name of a device's backend, including its wrappers.
pub fn backend_name(device: &Device) -> String {
    Dispatch::name(device.as_dispatch())
}

/// Does nothing without GPU kernels.
#[cfg(not(feature = "cube"))]
pub fn poison(_: bool) {}
