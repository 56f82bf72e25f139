//! Counters and switches for tests. Not part of the public interface.

use std::collections::BTreeMap;

use burn::tensor::Tensor;

pub use crate::abilities::buffer_limit;
pub use crate::counters::{
    allocated_bytes, bound_bytes, dispatches, expect_intersections, force_f32_in_f64, idle_waits, read_bytes,
    repeated_lists, twin_calls,
};
#[cfg(feature = "cube")]
pub use crate::gpu::poison;
pub use crate::limits::lower_limit;

/// Returns packed ellipses, `[N, 7]`.
pub fn packed(projected: &crate::Projected) -> &Tensor<2> {
    projected.packed()
}

/// Takes packed ellipses, `[N, 7]`, of a camera with these intrinsics.
pub fn of_packed(packed: Tensor<2>, intrinsics: crate::Intrinsics) -> crate::Projected {
    crate::Projected::of(packed, intrinsics)
}

/// Returns the slopes `[low, high]` along x and y at which a render with these options clamps the Jacobian.
pub fn slope_limits(camera: &crate::Intrinsics, options: &crate::RenderOptions) -> [[f64; 2]; 2] {
    camera.slope_limits(options.of_project(camera).jacobian_margin)
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

/// Does nothing without GPU kernels.
#[cfg(not(feature = "cube"))]
pub fn poison(_: bool) {}
