//! The program's allocator, and the memory that is held during a measurement.

use std::alloc::{GlobalAlloc, Layout};
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

#[cfg(not(target_os = "linux"))]
pub use mimalloc::MiMalloc as Fast;
#[cfg(target_os = "linux")]
pub use tikv_jemallocator::Jemalloc as Fast;

/// Options of jemalloc. All blocks come from one arena, so that a step has the blocks of the step before, and threads use what others freed.
/// Freed blocks go back to the system at once from 64 MiB on, and smaller ones within ten seconds. With jemalloc's default, 8 MiB, a step
/// with 300,000 splats spends a third of its processor time on pages that the system clears.
#[cfg(target_os = "linux")]
pub const OPTIONS: &[u8; 72] = b"narenas:1,oversize_threshold:67108864,calloc_madvise_threshold:67108864\0";

/// Makes [`Fast`](crate::memory::Fast) the allocator of a program, alone or in a wrapper (`allocator!(CountingAllocator<Fast>, CountingAllocator(Fast))`). It keeps
/// freed blocks for a while. A step allocates and frees tensors of megabytes; the system's allocator returns such blocks to the kernel
/// each time and has them cleared on the next use.
#[macro_export]
macro_rules! allocator {
    () => {
        $crate::allocator!($crate::memory::Fast, $crate::memory::Fast);
    };
    ($type:ty, $value:expr) => {
        #[global_allocator]
        static ALLOCATOR: $type = $value;

        // SAFETY: jemalloc reads a string under this name, which ends with a zero.
        #[cfg(target_os = "linux")]
        #[unsafe(export_name = "_rjem_malloc_conf")]
        static JEMALLOC_OPTIONS: &[u8; $crate::memory::OPTIONS.len()] = $crate::memory::OPTIONS;
    };
}

/// Whether bytes are counted. Otherwise the counter costs an allocation one load of this flag.
static COUNTS: AtomicBool = AtomicBool::new(false);
/// Bytes held beyond those at the start of the count; negative after older blocks were freed.
static LIVE: AtomicI64 = AtomicI64::new(0);
static PEAK: AtomicI64 = AtomicI64::new(0);

/// An allocator that counts while [`peak_mib`] runs.
pub struct CountingAllocator<A>(pub A);

fn changed(bytes: i64) {
    let live = LIVE.fetch_add(bytes, Relaxed) + bytes;
    PEAK.fetch_max(live, Relaxed);
}

// SAFETY: every call is forwarded unchanged.
unsafe impl<A: GlobalAlloc> GlobalAlloc for CountingAllocator<A> {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if COUNTS.load(Relaxed) {
            changed(layout.size() as i64);
        }
        unsafe { self.0.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if COUNTS.load(Relaxed) {
            changed(layout.size() as i64);
        }
        unsafe { self.0.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        if COUNTS.load(Relaxed) {
            changed(-(layout.size() as i64));
        }
        unsafe { self.0.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let counts = COUNTS.load(Relaxed);
        if counts {
            // Both blocks may exist at once while the contents move.
            changed(size as i64);
        }
        let moved = unsafe { self.0.realloc(block, layout, size) };
        if counts {
            changed(-(layout.size() as i64));
        }
        moved
    }
}

/// Runs `work` and returns its result and the peak memory of the program, on all threads, beyond the memory held
/// before, MiB. `None` in a program whose allocator is not [`CountingAllocator`]. Concurrent calls wait for each other. GPU
/// memory is not counted.
pub fn peak_mib<T>(work: impl FnOnce() -> T) -> (T, Option<f64>) {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _held = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    LIVE.store(0, Relaxed);
    PEAK.store(0, Relaxed);
    COUNTS.store(true, Relaxed);
    let result = work();
    COUNTS.store(false, Relaxed);
    let peak = PEAK.load(Relaxed);
    (result, (peak > 0).then(|| peak as f64 / f64::from(1 << 20)))
}

#[cfg(test)]
mod tests;
