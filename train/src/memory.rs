//! The program's allocator.

#[cfg(not(target_os = "linux"))]
pub use mimalloc::MiMalloc as Fast;
#[cfg(target_os = "linux")]
pub use tikv_jemallocator::Jemalloc as Fast;

/// Options of jemalloc. All blocks come from one arena, so that a step has the blocks of the step before, and threads use what others freed.
/// Freed blocks go back to the system at once from 64 MiB on, and smaller ones within ten seconds. With jemalloc's default, 8 MiB, a step
/// with 300,000 splats spends a third of its processor time on pages that the system clears.
#[cfg(target_os = "linux")]
pub const OPTIONS: &[u8; 72] = b"narenas:1,oversize_threshold:67108864,calloc_madvise_threshold:67108864\0";

/// Makes [`Fast`](crate::memory::Fast) the allocator of a program, alone or in a wrapper (`allocator!(Wrapper<Fast>, Wrapper(Fast))`). It keeps
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
