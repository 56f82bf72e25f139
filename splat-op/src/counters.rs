//! Counts of launches, allocations, waits and CPU stages of this process, for tests.

use std::cell::Cell;
use std::sync::atomic::{AtomicU64, Ordering};

/// Declares counters: a function that reads each, and one that adds to it.
macro_rules! counters {
    ($($counter:ident: $(#[$doc:meta])* $read:ident, $add:ident;)*) => {$(
        static $counter: AtomicU64 = AtomicU64::new(0);

        $(#[$doc])*
        pub fn $read() -> u64 {
            $counter.load(Ordering::Relaxed)
        }

        #[cfg_attr(not(feature = "cube"), allow(dead_code, reason = "most are for GPUs"))]
        pub(crate) fn $add(count: u64) {
            $counter.fetch_add(count, Ordering::Relaxed);
        }
    )*};
}

counters! {
    DISPATCHES:
    /// Returns the number of kernels of this crate that this process has launched so far, on all GPUs.
    dispatches, count_dispatches;
    ALLOCATED:
    /// Returns the bytes of all GPU buffers that the operations of this crate have allocated so far, without Burn's own.
    allocated_bytes, count_allocation;
    BOUND:
    /// Returns the bytes of all buffers that the kernels of this crate have been launched with so far, each counted at every launch:
    /// what the kernels would move if each read or wrote all of its buffers once.
    bound_bytes, count_binding;
    IDLE_WAITS:
    /// Returns the number of times that an operation of this crate has waited for a GPU that it had given nothing to do after what
    /// it waited for.
    idle_waits, count_idle_waits;
    READ:
    /// Returns the bytes that [`crate::read_back`] and the operations of this crate have copied from devices to the host so far.
    read_bytes, count_read;
    REPEATED_LISTS:
    /// Returns the number of views whose lists were written twice, because they were longer than expected.
    repeated_lists, count_repeated_lists;
    TRUNCATED:
    /// Returns the number of views whose lists are known to have been too short.
    truncated, count_truncated;
    TWIN_CALLS:
    /// Returns the number of stages that this process has computed on the CPU so far, forward and backward.
    twin_calls, count_twin_calls;
}

thread_local! {
    static F32_IN_F64: Cell<bool> = const { Cell::new(false) };
}

/// Sets whether this thread computes operations in f32 as a processor without AVX2 does.
pub fn force_f32_in_f64(on: bool) {
    F32_IN_F64.set(on);
}

pub(crate) fn is_f32_in_f64_forced() -> bool {
    F32_IN_F64.get()
}

static CAPACITY: AtomicU64 = AtomicU64::new(u64::MAX);

/// Sets how many intersections every view is expected to have, zero for an unknown number. With `None`, recent views tell.
pub fn expect_intersections(capacity: Option<u64>) {
    CAPACITY.store(capacity.unwrap_or(u64::MAX), Ordering::Relaxed);
}

#[cfg(feature = "cube")]
pub(crate) fn forced_capacity() -> Option<u64> {
    Some(CAPACITY.load(Ordering::Relaxed)).filter(|capacity| *capacity < u64::MAX)
}
