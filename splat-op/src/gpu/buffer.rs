//! Typed buffers on the device.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicBool, Ordering};

use bytemuck::Pod;
use cubecl::prelude::*;
use cubecl::server::Handle;

use super::{Gpu, given, launch_unchecked};
use crate::counters::{count_allocation, count_binding, count_idle_waits};
use crate::limits::Need;

static POISON: AtomicBool = AtomicBool::new(false);

/// Sets whether every new buffer of the kernels is filled with the bits of NaN, so that an unwritten slot shows. For tests: it
/// costs a copy per buffer.
pub fn poison(on: bool) {
    POISON.store(on, Ordering::Relaxed);
}

/// What a launch takes for an argument of a kernel: the argument itself, a buffer, one that may be missing, or a number of elements.
pub(crate) trait Argument<A> {
    fn argument(self) -> A;
}

impl<A> Argument<A> for A {
    fn argument(self) -> A {
        self
    }
}

impl<T> Argument<BufferArg> for &Buffer<T> {
    fn argument(self) -> BufferArg {
        self.arg()
    }
}

impl<T, K: LaunchArg<RuntimeArg = BufferArg>> Argument<ComptimeOptionArgs<K>> for Option<&Buffer<T>> {
    fn argument(self) -> ComptimeOptionArgs<K> {
        self.map(Buffer::arg).into()
    }
}

impl<T, K: LaunchArg<RuntimeArg = BufferArg>> Argument<ComptimeOptionArgs<K>> for &Option<Buffer<T>> {
    fn argument(self) -> ComptimeOptionArgs<K> {
        self.as_ref().argument()
    }
}

// Numbers of elements fit: see `INDEX_LIMIT`.
impl Argument<u32> for usize {
    fn argument(self) -> u32 {
        self as u32
    }
}

/// Rounds a length up to a multiple of an eighth of the next power of two, so that a slightly larger length finds the same memory again.
pub(crate) fn roomy(len: usize) -> usize {
    len.next_multiple_of((len.next_power_of_two() / 8).max(1))
}

/// Bytes at whose multiples every device can bind a part of a buffer.
pub(crate) const PART_BYTES: usize = 1024;

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
        self.vectors(1)
    }

    /// Returns the elements `first..first + len`, which begin at a multiple of [`PART_BYTES`].
    pub fn part(&self, first: usize, len: usize) -> Self {
        let bytes = |elements: usize| (elements * size_of::<T>()) as u64;
        debug_assert!(
            bytes(first).is_multiple_of(PART_BYTES as u64) && first + len <= self.len,
            "{first} + {len} of {}",
            self.len
        );
        let rest = self.handle.size_in_used() - bytes(first + len);
        Self::from_handle(self.handle.clone().offset_start(bytes(first)).offset_end(rest), len)
    }

    /// Returns the buffer as a kernel argument of whole vectors of `size` elements.
    pub fn vectors(&self, size: usize) -> BufferArg {
        count_binding((self.len * size_of::<T>()) as u64);
        debug_assert!(self.len.is_multiple_of(size), "{} elements are no vectors of {size}", self.len);
        // SAFETY: a buffer is made with at least this many elements.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len / size) }
    }
}

impl<T: Pod> Buffer<T> {
    /// Allocates a buffer without writing to it.
    pub fn new(gpu: &Gpu, len: usize) -> Self {
        Self::with_room(gpu, len, (len * size_of::<T>()).div_ceil(4))
    }

    /// [`Buffer::new`] for a length that depends on the data, with [`roomy`] memory.
    pub fn with_headroom(gpu: &Gpu, len: usize) -> Self {
        let words = (len * size_of::<T>()).div_ceil(4);
        Self::with_room(gpu, len, roomy(words).min((gpu.buffer_limit / 4) as usize).max(words))
    }

    fn with_room(gpu: &Gpu, len: usize, words: usize) -> Self {
        // Devices cannot bind an empty buffer.
        let words = words.max(1);
        // Sizes known beforehand are checked at the public functions, and large buffers are checked by name; this check covers all others.
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
        let [Some(buffer), ..] = Self::zeros_of(gpu, [Some(len), None, None, None]) else { unreachable!("asked for") };
        buffer
    }

    /// Returns buffers of zero bits of the given lengths, cleared by one launch. Elements have four bytes.
    pub fn zeros_of(gpu: &Gpu, lens: [Option<usize>; 4]) -> [Option<Self>; 4] {
        const { assert!(size_of::<T>() == 4) };
        let buffers = lens.map(|len| len.map(|len| Self::new(gpu, len)));
        let longest = buffers.iter().flatten().map(|buffer| buffer.len).max().unwrap_or(0);
        let ([e, f, g, h], [a, b, c, d]) = (buffers.each_ref(), lens.map(Option::unwrap_or_default));
        // SAFETY: every access is guarded by the lengths given.
        launch_unchecked!(gpu.units(longest), clear_kernel(e, f, g, h, a, b, c, d, given([e, f, g, h])));
        buffers
    }

    /// Waits for the device and copies the elements back.
    pub fn read(&self, gpu: &Gpu) -> Vec<T> {
        count_idle_waits(1);
        let bytes = gpu.client.read_one(self.handle.clone()).unwrap_or_else(|error| panic!("{error}"));
        bytemuck::pod_collect_to_vec(&bytes[..self.len * size_of::<T>()])
    }
}

#[cube(launch_unchecked)]
fn clear_kernel(
    mut first: ComptimeOption<Box<[u32]>>,
    mut second: ComptimeOption<Box<[u32]>>,
    mut third: ComptimeOption<Box<[u32]>>,
    mut fourth: ComptimeOption<Box<[u32]>>,
    first_len: u32,
    second_len: u32,
    third_len: u32,
    fourth_len: u32,
    #[comptime] _given: u32,
) {
    clear_own(&mut first, first_len);
    clear_own(&mut second, second_len);
    clear_own(&mut third, third_len);
    clear_own(&mut fourth, fourth_len);
}

/// Clears this unit's word, if there is a buffer and it has that word.
#[cube]
fn clear_own(words: &mut ComptimeOption<Box<[u32]>>, len: u32) {
    #[comptime]
    if let ComptimeOption::Some(words) = words {
        let exists = ABSOLUTE_POS < len as usize;
        if exists {
            words[ABSOLUTE_POS] = 0u32;
        }
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
    // SAFETY: every access is guarded by the length given, and the factor is one number.
    launch_unchecked!(gpu.units(values.len), scale_kernel(values, factor, values.len));
}

#[cfg(test)]
mod kernel_tests;
