//! Limits of a device's buffers: checks before a stage runs if the size is known by then, and a panic message otherwise.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::{Result, SplatError};

/// A buffer that a call needs.
pub(crate) struct Need {
    /// The argument or result that the buffer holds.
    pub what: &'static str,
    pub bytes: u64,
    /// What to change so that the buffer becomes smaller.
    pub hint: &'static str,
}

impl Need {
    /// A buffer of f32 values, the only floats of GPUs.
    pub fn floats<const D: usize>(what: &'static str, shape: [usize; D], hint: &'static str) -> Self {
        // Saturating: a size beyond u64 fits nowhere either.
        let bytes = shape.iter().fold(size_of::<f32>() as u64, |bytes, size| bytes.saturating_mul(*size as u64));
        Self { what, bytes, hint }
    }

    pub fn check(&self, limit_bytes: u64) -> Result<()> {
        let &Self { what, bytes: needed_bytes, hint } = self;
        match needed_bytes <= limit_bytes {
            true => Ok(()),
            false => Err(SplatError::TooLarge { what, needed_bytes, limit_bytes, hint }),
        }
    }

    /// Panics if the buffer does not fit. For sizes that depend on the data and are only known inside an operation, which cannot
    /// return an error: Burn passes the panic on to the reader of the result.
    #[cfg(feature = "cube")]
    pub fn assert_fits(&self, limit_bytes: u64) {
        if let Err(error) = self.check(limit_bytes) {
            panic!("{error}");
        }
    }
}

/// Bound of the size of buffers and tensors, for tests.
static LARGEST: AtomicU64 = AtomicU64::new(u64::MAX);

/// Lowers the size of every device's largest buffer and tensor to `bytes`. For tests of steps that exceed a real device's.
pub fn lower_limit(bytes: u64) {
    LARGEST.store(bytes, Ordering::Relaxed);
}

/// The bound that [`lower_limit`] sets.
pub(crate) fn lowered_limit() -> u64 {
    LARGEST.load(Ordering::Relaxed)
}

#[cfg(test)]
mod tests;
