//! Counts the memory that a program allocates.

use std::alloc::{GlobalAlloc, Layout};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);
static TOTAL: AtomicUsize = AtomicUsize::new(0);

/// An allocator that counts allocated bytes.
pub struct CountingAllocator<A>(pub A);

fn asked(size: usize) {
    TOTAL.fetch_add(size, Relaxed);
    let live = LIVE.fetch_add(size, Relaxed) + size;
    PEAK.fetch_max(live, Relaxed);
}

// SAFETY: every call is forwarded unchanged.
unsafe impl<A: GlobalAlloc> GlobalAlloc for CountingAllocator<A> {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        asked(layout.size());
        unsafe { self.0.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        asked(layout.size());
        unsafe { self.0.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        unsafe { self.0.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Both blocks may exist at once while the contents move.
        asked(size);
        let moved = unsafe { self.0.realloc(block, layout, size) };
        LIVE.fetch_sub(layout.size(), Relaxed);
        moved
    }
}

/// Allocated bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allocated {
    /// Total of all allocations.
    pub total: usize,
    /// Most bytes held at a time, beyond the bytes held before.
    pub peak: usize,
}

/// Returns the bytes that the program holds now, if its allocator is [`CountingAllocator`].
pub fn held() -> usize {
    LIVE.load(Relaxed)
}

/// Runs `work` in a program whose allocator is [`CountingAllocator`]. Also returns the bytes allocated meanwhile, on all threads.
pub fn allocated<T>(work: impl FnOnce() -> T) -> (T, Allocated) {
    let (held, total) = (LIVE.load(Relaxed), TOTAL.load(Relaxed));
    PEAK.store(held, Relaxed);
    let result = work();
    let peak = PEAK.load(Relaxed).saturating_sub(held);
    (result, Allocated { total: TOTAL.load(Relaxed) - total, peak })
}
