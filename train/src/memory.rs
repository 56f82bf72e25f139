//! The program's allocator: where large blocks come from, and the memory that is held during a measurement.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

/// Bytes from which a block is large. The tensors of a step of a million splats of degree 3 are smaller, so that each step uses the
/// blocks of the step before.
const LARGE: usize = 256 << 20;

/// An allocator that takes large blocks from the system, and others from `A`. The system has the memory of a large block back at once
/// when it is freed, where allocators such as mimalloc keep it for a while. A large scene would need memory for both: a
/// step frees blocks of gigabytes and allocates others of another size.
pub struct LargeFromSystem<A>(pub A);

// SAFETY: every call is forwarded to the allocator that the block's size belongs to, which is the one that allocated the block.
unsafe impl<A: GlobalAlloc> GlobalAlloc for LargeFromSystem<A> {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        unsafe { if layout.size() >= LARGE { System.alloc(layout) } else { self.0.alloc(layout) } }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        unsafe { if layout.size() >= LARGE { System.alloc_zeroed(layout) } else { self.0.alloc_zeroed(layout) } }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        unsafe { if layout.size() >= LARGE { System.dealloc(block, layout) } else { self.0.dealloc(block, layout) } }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        match (layout.size() >= LARGE, size >= LARGE) {
            (true, true) => unsafe { System.realloc(block, layout, size) },
            (false, false) => unsafe { self.0.realloc(block, layout, size) },
            _ => unsafe {
                // The caller guarantees that `size` fits the alignment.
                let moved = self.alloc(Layout::from_size_align_unchecked(size, layout.align()));
                if !moved.is_null() {
                    ptr::copy_nonoverlapping(block, moved, size.min(layout.size()));
                    self.dealloc(block, layout);
                }
                moved
            },
        }
    }
}

/// Whether bytes are counted. Otherwise the counter costs an allocation one load of this flag.
static COUNTS: AtomicBool = AtomicBool::new(false);
/// Bytes held beyond those at the start of the count; negative after older blocks were freed.
static LIVE: AtomicI64 = AtomicI64::new(0);
static PEAK: AtomicI64 = AtomicI64::new(0);

/// An allocator that counts while [`peak_mib`] runs.
pub struct Counted<A>(pub A);

fn changed(bytes: i64) {
    let live = LIVE.fetch_add(bytes, Relaxed) + bytes;
    PEAK.fetch_max(live, Relaxed);
}

// SAFETY: every call is forwarded unchanged.
unsafe impl<A: GlobalAlloc> GlobalAlloc for Counted<A> {
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
/// before, MiB. `None` in a program whose allocator is not [`Counted`]. Concurrent calls wait for each other. GPU
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
mod tests {
    use std::alloc::System;

    use super::*;

    /// An allocator that has no memory.
    struct Nothing;

    // SAFETY: no block is allocated.
    unsafe impl GlobalAlloc for Nothing {
        unsafe fn alloc(&self, _: Layout) -> *mut u8 {
            ptr::null_mut()
        }

        unsafe fn dealloc(&self, _: *mut u8, _: Layout) {
            panic!("a block of the system")
        }
    }

    #[test]
    fn large_blocks_come_from_the_system_alone() {
        let layout = |size| Layout::from_size_align(size, 8).unwrap();
        let (small, large) = (layout(LARGE - 1), layout(LARGE));
        let from_nothing = LargeFromSystem(Nothing);
        // SAFETY: blocks are freed with the layouts they were allocated with, and no byte beyond their ends is used.
        unsafe {
            assert!(from_nothing.alloc(small).is_null() && from_nothing.alloc_zeroed(small).is_null());
            let block = from_nothing.alloc_zeroed(large);
            assert_eq!(*block.add(LARGE - 1), 0);
            assert!(from_nothing.realloc(block, large, LARGE - 1).is_null(), "the block is lost");
            let block = from_nothing.realloc(block, large, 2 * LARGE);
            assert!(!block.is_null());
            from_nothing.dealloc(block, layout(2 * LARGE));

            // Bytes are kept when a block becomes large and small again.
            let from_system = LargeFromSystem(System);
            let block = from_system.alloc(small);
            block.add(LARGE - 2).write(7);
            let block = from_system.realloc(block, small, LARGE);
            assert_eq!(*block.add(LARGE - 2), 7);
            let block = from_system.realloc(block, large, 16);
            from_system.dealloc(block, layout(16));
        }
    }

    #[test]
    fn the_most_that_is_held_at_a_time_counts() {
        let counted = Counted(System);
        let layout = |size| Layout::from_size_align(size, 8).unwrap();
        // SAFETY: blocks are freed with the layouts they were allocated with.
        let ((), peak) = peak_mib(|| unsafe {
            let first = counted.alloc(layout(3 << 20));
            counted.dealloc(first, layout(3 << 20));
            let second = counted.alloc_zeroed(layout(1 << 20));
            let second = counted.realloc(second, layout(1 << 20), 4 << 20);
            counted.dealloc(second, layout(4 << 20));
        });
        assert_eq!(peak, Some(5.0));
        assert_eq!(peak_mib(|| ()).1, None);
    }
}
