//! Tensor code in place of operations.

use std::cell::Cell;

thread_local! {
    static ON: Cell<bool> = const { Cell::new(false) };
}

/// Runs `task` with tensor code in place of all operations but those of the rasterizer (`project`, `evaluate_sh`, `intersect`,
/// `rasterize`): activation, effects, loss, Adam, the search for values that are not finite, and sorts of rows. Results are the same up to
/// rounding. For checks of operations, and for devices and changes that they do not know.
///
/// It concerns the calling thread alone. Gradients of what `task` computes may be taken later.
pub fn in_tensor_code<T>(task: impl FnOnce() -> T) -> T {
    struct Restored(bool);
    impl Drop for Restored {
        fn drop(&mut self) {
            ON.set(self.0);
        }
    }
    let _restored = Restored(ON.replace(true));
    task()
}

/// Returns whether this thread is within [`in_tensor_code`].
pub fn is_tensor_code() -> bool {
    ON.get()
}

#[cfg(test)]
mod tests;
