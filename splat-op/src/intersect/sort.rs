//! A stable radix sort of u32 keys with u32 values on the device: least significant digit first, four bits at a time.
//!
//! A pass counts the digits of each block of keys, scans the counts (digit by digit, within a digit block by block) and
//! lets each block write its keys to their places. Within a block each unit holds consecutive keys and has a counter of
//! its own for each digit, so that the scan of the counters gives every key a place without a race, in order.

use cubecl::prelude::*;

use super::scan::launch_scan;
use crate::gpu::reduce::cube_exclusive_sum;
use crate::gpu::{Buffer, Gpu, UNITS, cubes};

/// Number of bits of a digit: 16 counters for each of 256 units fill 16 KiB of shared memory, the least that devices
/// offer.
const BITS: u32 = 4;
const DIGITS: usize = 1 << BITS;

/// Number of consecutive keys of a unit.
const PER_UNIT: usize = 16;

/// Number of keys of a cube.
const BLOCK: usize = UNITS * PER_UNIT;

/// Counts each unit's keys by digit into `counters`, `[digit][unit]`.
#[cube]
fn count_digits(keys: &[u32], counters: &mut Shared<[u32]>, len: u32, shift: u32) {
    let unit = UNIT_POS as usize;
    #[unroll]
    for digit in 0..comptime!(DIGITS) {
        counters[digit * comptime!(UNITS) + unit] = 0u32;
    }
    let at = CUBE_POS * comptime!(BLOCK) + unit * comptime!(PER_UNIT);
    for i in 0..comptime!(PER_UNIT) {
        if at + i < len as usize {
            let digit = ((keys[at + i] >> shift) & comptime!(DIGITS as u32 - 1)) as usize;
            counters[digit * comptime!(UNITS) + unit] += 1u32;
        }
    }
}

/// Writes `counts[digit][block]`, the number of keys of each block by digit.
#[cube(launch_unchecked)]
fn histogram_kernel(keys: &[u32], counts: &mut [u32], len: u32, blocks: u32, shift: u32) {
    let mut counters = Shared::<[u32]>::new_slice(comptime!(DIGITS * UNITS));
    if CUBE_POS < blocks as usize {
        count_digits(keys, &mut counters, len, shift);
        sync_cube();
        // Sixteen units add up the counters of a digit, then one of them adds up their sums.
        let unit = UNIT_POS as usize;
        let mut sum = 0u32;
        for i in 0..comptime!(DIGITS) {
            sum += counters[unit * comptime!(DIGITS) + i];
        }
        sync_cube();
        counters[unit] = sum;
        sync_cube();
        if unit < comptime!(DIGITS) {
            let mut total = 0u32;
            for i in 0..comptime!(UNITS / DIGITS) {
                total += counters[unit * comptime!(UNITS / DIGITS) + i];
            }
            counts[unit * blocks as usize + CUBE_POS] = total;
        }
    }
}

/// Writes each key and its value to the place given by `starts[digit][block]` and the key's rank within the block.
#[cube(launch_unchecked)]
fn scatter_kernel(
    keys: &[u32],
    values: &[u32],
    starts: &[u32],
    sorted_keys: &mut [u32],
    sorted_values: &mut [u32],
    len: u32,
    blocks: u32,
    shift: u32,
    #[comptime] planes: bool,
) {
    let mut counters = Shared::<[u32]>::new_slice(comptime!(DIGITS * UNITS));
    let mut shared = Shared::<[u32]>::new_slice(comptime!(UNITS + 1));
    if CUBE_POS < blocks as usize {
        count_digits(keys, &mut counters, len, shift);
        sync_cube();
        let unit = UNIT_POS as usize;
        // Exclusive scan of all counters: each unit takes as many consecutive counters as there are digits.
        let mut sum = 0u32;
        for i in 0..comptime!(DIGITS) {
            let here = counters[unit * comptime!(DIGITS) + i];
            counters[unit * comptime!(DIGITS) + i] = sum;
            sum += here;
        }
        let (before, _) = cube_exclusive_sum(sum, &mut shared, planes);
        for i in 0..comptime!(DIGITS) {
            counters[unit * comptime!(DIGITS) + i] += before;
        }
        sync_cube();
        // Offsets from ranks in the block to places in the result.
        if unit < comptime!(DIGITS) {
            shared[unit] = starts[unit * blocks as usize + CUBE_POS] - counters[unit * comptime!(UNITS)];
        }
        sync_cube();
        let at = CUBE_POS * comptime!(BLOCK) + unit * comptime!(PER_UNIT);
        for i in 0..comptime!(PER_UNIT) {
            if at + i < len as usize {
                let key = keys[at + i];
                let digit = ((key >> shift) & comptime!(DIGITS as u32 - 1)) as usize;
                let rank = counters[digit * comptime!(UNITS) + unit];
                counters[digit * comptime!(UNITS) + unit] = rank + 1u32;
                // The difference may have wrapped; the sum is right again.
                let place = (shared[digit] + rank) as usize;
                sorted_keys[place] = key;
                sorted_values[place] = values[at + i];
            }
        }
    }
}

/// Keys, each with a value.
#[derive(Clone, Debug)]
pub(crate) struct Pairs {
    pub keys: Buffer<u32>,
    pub values: Buffer<u32>,
}

/// Sorts by the lowest `bits` bits of the keys, [`BITS`] bits at a time; equal keys keep their order. The given buffers
/// are used as scratch.
pub(crate) fn launch_sort(gpu: &Gpu, pairs: Pairs, bits: u32) -> Pairs {
    let len = pairs.keys.len;
    if len <= 1 || bits == 0 {
        return pairs;
    }
    let mut from = pairs;
    let mut to = Pairs { keys: Buffer::with_headroom(gpu, len), values: Buffer::with_headroom(gpu, len) };
    let (client, blocks, dim) = (&gpu.client, len.div_ceil(BLOCK), CubeDim::new_1d(UNITS as u32));
    let (keys, count) = (len as u32, blocks as u32);
    for shift in (0..bits).step_by(BITS as usize) {
        let starts = Buffer::new(gpu, DIGITS * blocks);
        let (from_keys, digits) = (from.keys.arg(), starts.arg());
        // SAFETY: every access is guarded by the lengths given; ranks stay below `len` because they are a permutation.
        unsafe {
            histogram_kernel::launch_unchecked(client, cubes(blocks), dim, from_keys, digits, keys, count, shift);
            launch_scan(gpu, &starts);
            scatter_kernel::launch_unchecked(
                client,
                cubes(blocks),
                dim,
                from.keys.arg(),
                from.values.arg(),
                starts.arg(),
                to.keys.arg(),
                to.values.arg(),
                keys,
                count,
                shift,
                gpu.planes,
            );
        }
        std::mem::swap(&mut from, &mut to);
    }
    from
}
