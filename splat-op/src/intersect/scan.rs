//! Exclusive prefix sums of u32 on the device, in place, of any length.

use cubecl::prelude::*;

use crate::gpu::reduce::{cube_exclusive_sum, saturating};
use crate::gpu::{Buffer, Gpu, UNITS, cubes};

/// Number of consecutive elements of a unit.
const PER_UNIT: usize = 8;

/// Number of elements of a cube.
const BLOCK: usize = UNITS * PER_UNIT;

/// Largest number of blocks that one cube scans in turn: a second dispatch would take longer.
const SERIAL_BLOCKS: usize = 8;

/// Each cube scans one block, or the only cube scans `blocks` of them in turn, and writes its total.
#[cube(launch_unchecked)]
fn scan_blocks_kernel(
    values: &mut [u32],
    totals: &mut [u32],
    len: u32,
    blocks: u32,
    #[comptime] serial: bool,
    #[comptime] planes: bool,
) {
    let mut shared = Shared::<[u32]>::new_slice(comptime!(UNITS + 1));
    let mut carried = 0u32;
    let mut first = CUBE_POS;
    let mut end = CUBE_POS + 1;
    if comptime!(serial) {
        first = 0usize.runtime();
        end = blocks as usize;
    }
    if CUBE_POS < blocks as usize {
        for block in first..end {
            let at = block * comptime!(BLOCK) + UNIT_POS as usize * comptime!(PER_UNIT);
            let mut own = Array::<u32>::new(comptime!(PER_UNIT));
            let mut sum = 0u32;
            #[unroll]
            for i in 0..comptime!(PER_UNIT) {
                own[i] = sum;
                if at + i < len as usize {
                    sum = saturating(sum, values[at + i]);
                }
            }
            let (before, total) = cube_exclusive_sum(sum, &mut shared, planes);
            let before = saturating(before, carried);
            #[unroll]
            for i in 0..comptime!(PER_UNIT) {
                if at + i < len as usize {
                    values[at + i] = saturating(own[i], before);
                }
            }
            carried = saturating(carried, total);
        }
        if UNIT_POS == 0 {
            totals[CUBE_POS] = carried;
        }
    }
}

/// Adds the sum of the preceding blocks to the elements of each block.
#[cube(launch_unchecked)]
fn add_offsets_kernel(values: &mut [u32], offsets: &[u32], len: u32) {
    if ABSOLUTE_POS < len as usize {
        values[ABSOLUTE_POS] = saturating(values[ABSOLUTE_POS], offsets[ABSOLUTE_POS / comptime!(BLOCK)]);
    }
}

/// Replaces each value by the sum of those before it and returns the sum of all, one element. Sums that do not fit into
/// u32 become its maximum.
pub(crate) fn launch_scan(gpu: &Gpu, values: &Buffer<u32>) -> Buffer<u32> {
    let blocks = values.len.div_ceil(BLOCK).max(1);
    let serial = blocks <= SERIAL_BLOCKS;
    let grid = if serial { 1 } else { blocks };
    let totals = Buffer::new(gpu, grid);
    // SAFETY: every access is guarded by the lengths given.
    unsafe {
        scan_blocks_kernel::launch_unchecked(
            &gpu.client,
            cubes(grid),
            CubeDim::new_1d(UNITS as u32),
            values.arg(),
            totals.arg(),
            values.len as u32,
            blocks as u32,
            serial,
            gpu.planes,
        );
    }
    if serial {
        return totals;
    }
    let total = launch_scan(gpu, &totals);
    let (count, dim) = crate::gpu::elementwise(values.len);
    // SAFETY: every access is guarded by the lengths given.
    unsafe {
        add_offsets_kernel::launch_unchecked(&gpu.client, count, dim, values.arg(), totals.arg(), values.len as u32);
    }
    total
}
