//! Typed buffers on the device.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, Ordering};

use bytemuck::Pod;
use cubecl::prelude::*;
use cubecl::server::Handle;

use super::{Gpu, elementwise};
use crate::counters::count_allocation;
use crate::limits::Need;

static POISON: AtomicBool = AtomicBool::new(false);

/// Sets whether every new buffer of the kernels is filled with the bits of NaN, so that an unwritten slot shows. For tests: it
/// costs a copy per buffer.
pub fn poison(on: bool) {
    POISON.store(on, Ordering::Relaxed);
}

/// The bits of a quiet NaN. As an index, the value lies beyond every buffer.
const NAN_BITS: u32 = 0x7fc0_dead;

/// A buffer of `len` elements on the device.
#[derive(Debug)]
pub(crate) struct Buffer<T> {
    pub handle: Handle,
    pub len: usize,
    element: PhantomData<fn() -> T>,
}

impl<T> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self::from_handle(self.handle.clone(), self.len)
    }
}

impl<T> Buffer<T> {
    pub fn from_handle(handle: Handle, len: usize) -> Self {
        Self { handle, len, element: PhantomData }
    }

    /// Returns the buffer as a kernel argument.
    pub fn arg(&self) -> BufferArg {
        // SAFETY: a buffer is made with at least this many elements.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len) }
    }
}

impl<T: Pod> Buffer<T> {
    /// Allocates a buffer without writing to it.
    pub fn new(gpu: &Gpu, len: usize) -> Self {
        Self::with_room(gpu, len, (len * size_of::<T>()).div_ceil(4))
    }

    /// [`Buffer::new`] for a length that depends on the data. The memory is rounded up to a multiple of an eighth of the next
    /// power of two, so that a slightly larger length finds the same memory again.
    pub fn with_headroom(gpu: &Gpu, len: usize) -> Self {
        let words = (len * size_of::<T>()).div_ceil(4);
        let roomy = words.next_multiple_of((words.next_power_of_two() / 8).max(1));
        Self::with_room(gpu, len, roomy.min((gpu.buffer_limit / 4) as usize).max(words))
    }

    fn with_room(gpu: &Gpu, len: usize, words: usize) -> Self {
        // Devices cannot bind an empty buffer.
        let words = words.max(1);
        // Sizes known beforehand are checked at the public functions, and large buffers are checked by name; this check covers
        // all others.
        let need = Need {
            what: "a buffer of the kernels",
            bytes: 4 * words as u64,
            hint: "render a smaller picture, fewer Gaussians or fewer channels, or raise `alpha_min`",
        };
        need.assert_fits(gpu.buffer_limit);
        count_allocation(4 * words as u64);
        let handle = match POISON.load(Ordering::Relaxed) {
            true => gpu.client.create_from_slice(bytemuck::cast_slice(&vec![NAN_BITS; words])),
            false => gpu.client.empty(4 * words),
        };
        Self::from_handle(handle, len)
    }

    /// Returns a new buffer if the output is needed.
    pub fn if_needed(gpu: &Gpu, needed: bool, len: usize) -> Option<Self> {
        needed.then(|| Self::new(gpu, len))
    }

    pub fn from_slice(gpu: &Gpu, elements: &[T]) -> Self {
        match elements.is_empty() {
            true => Self::new(gpu, 0),
            false => Self::from_handle(gpu.client.create_from_slice(bytemuck::cast_slice(elements)), elements.len()),
        }
    }

    /// Returns a buffer of zero bits.
    pub fn zeros(gpu: &Gpu, len: usize) -> Self {
        let buffer = Self::new(gpu, len);
        let words = Buffer::<u32>::from_handle(buffer.handle.clone(), len * size_of::<T>() / 4);
        let (grid, dim) = elementwise(words.len);
        // SAFETY: every access is guarded by the length given.
        unsafe { clear_kernel::launch_unchecked(&gpu.client, grid, dim, words.arg(), words.len as u32) };
        buffer
    }

    /// Waits for the device and copies the elements back.
    #[cfg(test)]
    pub fn read(&self, gpu: &Gpu) -> Vec<T> {
        let bytes = gpu.client.read_one(self.handle.clone()).unwrap_or_else(|error| panic!("{error}"));
        bytemuck::pod_collect_to_vec(&bytes[..self.len * size_of::<T>()])
    }
}

#[cube(launch_unchecked)]
fn clear_kernel(words: &mut [u32], len: u32) {
    if ABSOLUTE_POS < len as usize {
        words[ABSOLUTE_POS] = 0u32;
    }
}

#[cube(launch_unchecked)]
fn scale_kernel(values: &mut [f32], factor: &[f32], len: u32) {
    let by = factor[0];
    if ABSOLUTE_POS < len as usize {
        values[ABSOLUTE_POS] *= by;
    }
}

/// Multiplies values by a number, in place.
pub(crate) fn launch_scale(gpu: &Gpu, values: &Buffer<f32>, factor: &Buffer<f32>) {
    if values.len > 0 {
        let (grid, dim) = elementwise(values.len);
        // SAFETY: every access is guarded by the length given, and the factor is one number.
        unsafe {
            scale_kernel::launch_unchecked(&gpu.client, grid, dim, values.arg(), factor.arg(), values.len as u32)
        };
    }
}
