//! Counts of launches, allocations, waits and CPU stages of this process, for tests.

#[cfg(feature = "cube")]
use std::sync::atomic::AtomicBool;
use std::sync::atomic::{AtomicU64, Ordering};

static DISPATCHES: AtomicU64 = AtomicU64::new(0);
static TWIN_CALLS: AtomicU64 = AtomicU64::new(0);
static ALLOCATED: AtomicU64 = AtomicU64::new(0);
static BOUND: AtomicU64 = AtomicU64::new(0);
static IDLE_WAITS: AtomicU64 = AtomicU64::new(0);
static READ: AtomicU64 = AtomicU64::new(0);
static REPEATED_LISTS: AtomicU64 = AtomicU64::new(0);
static CAPACITY: AtomicU64 = AtomicU64::new(u64::MAX);
#[cfg(feature = "cube")]
static COUNT_PAIRS: AtomicBool = AtomicBool::new(false);

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

/// Returns the number of times that an operation of this crate has waited for a GPU that it had given nothing to do after what
/// it waited for.
pub fn idle_waits() -> u64 {
    IDLE_WAITS.load(Ordering::Relaxed)
}

/// Returns the bytes that [`crate::read_back`] and the operations of this crate have copied from devices to the host so far.
pub fn read_bytes() -> u64 {
    READ.load(Ordering::Relaxed)
}

pub(crate) fn count_read(bytes: u64) {
    READ.fetch_add(bytes, Ordering::Relaxed);
}

/// Returns the number of views whose lists were written twice, because they were longer than expected.
pub fn repeated_lists() -> u64 {
    REPEATED_LISTS.load(Ordering::Relaxed)
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

#[cfg(feature = "cube")]
pub(crate) fn count_idle_wait() {
    IDLE_WAITS.fetch_add(1, Ordering::Relaxed);
}

#[cfg(feature = "cube")]
pub(crate) fn count_repeated_lists() {
    REPEATED_LISTS.fetch_add(1, Ordering::Relaxed);
}

/// Sets how many intersections every view is expected to have, zero for an unknown number. With `None`, recent views tell.
pub fn expect_intersections(capacity: Option<u64>) {
    CAPACITY.store(capacity.unwrap_or(u64::MAX), Ordering::Relaxed);
}

#[cfg(feature = "cube")]
pub(crate) fn forced_capacity() -> Option<u64> {
    Some(CAPACITY.load(Ordering::Relaxed)).filter(|capacity| *capacity < u64::MAX)
}

pub(crate) fn count_twin_call() {
    TWIN_CALLS.fetch_add(1, Ordering::Relaxed);
}

/// Numbers of pairs of a pixel and a Gaussian in a view. A pair that a block evaluates counts once for each of its 32 pixels,
/// finished or not, because they share its time on a card.
#[cfg(feature = "cube")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PairCounts {
    /// Pairs evaluated by the forward pass.
    pub evaluated_forwards: u64,
    /// Pairs whose gradient the backward pass evaluates.
    pub evaluated_backwards: u64,
    /// Pairs that contribute to the picture.
    pub contributing: u64,
}

/// Sets whether renders that keep a trace count pairs of a pixel and a Gaussian on GPUs.
#[cfg(feature = "cube")]
pub fn count_pairs(on: bool) {
    COUNT_PAIRS.store(on, Ordering::Relaxed);
}

#[cfg(feature = "cube")]
pub(crate) fn pairs_are_counted() -> bool {
    COUNT_PAIRS.load(Ordering::Relaxed)
}
