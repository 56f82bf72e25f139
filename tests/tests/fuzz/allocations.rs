//! The memory that a thread holds, and its peak.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    // Constants without destructors, so that the allocator can use them at any time of a thread's life.
    static LIVE: Cell<isize> = const { Cell::new(0) };
    static MOST: Cell<isize> = const { Cell::new(0) };
}

/// The system allocator, with counts per thread.
pub struct ThreadCountingAllocator;

fn count(change: isize) {
    let _ = LIVE.try_with(|live| {
        live.set(live.get() + change);
        let _ = MOST.try_with(|most| most.set(most.get().max(live.get())));
    });
}

// SAFETY: every call is forwarded unchanged.
unsafe impl GlobalAlloc for ThreadCountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Both blocks may exist at once while the contents move.
        count(size as isize);
        let moved = unsafe { System.realloc(block, layout, size) };
        count(-(layout.size() as isize));
        moved
    }
}

/// Runs `work`. Also returns the most bytes that this thread held meanwhile, beyond those it held before.
pub fn most_held<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = LIVE.get();
    MOST.set(before);
    let result = work();
    (result, (MOST.get() - before).max(0) as usize)
}

#[test]
fn the_most_is_what_was_held_at_once() {
    let (_, most) = most_held(|| {
        drop(vec![0_u8; 1_000_000]);
        let kept = vec![0_u8; 300_000];
        drop(vec![0_u8; 100_000]);
        kept
    });
    assert!((1_000_000..1_001_000).contains(&most), "{most}");
    let (_, grown) = most_held(|| {
        let mut bytes = Vec::with_capacity(10);
        bytes.resize(200_000, 1_u8);
        bytes
    });
    assert!((200_000..402_000).contains(&grown), "{grown}");
}
