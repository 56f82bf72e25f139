use std::alloc::System;

use super::*;

#[test]
fn the_most_that_is_held_at_a_time_counts() {
    let counted = CountingAllocator(System);
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
