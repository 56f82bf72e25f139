//! In which order units of a driver in software take what there is to do: the longest first, so that none is left with it at the
//! end.

use super::buckets::{LENGTH_BITS, blend_lengths_kernel};
use super::launch::slots;
use super::layer::Shape;
use super::quads_forward::{self, blend_tile_lengths_kernel};
use crate::gpu::{Buffer, Gpu, elementwise};
use crate::tile::launch::DeviceLists;
use crate::tile::sort::{Pairs, launch_sort};

/// The tiles by the lengths of their lists, the longest first.
pub(super) fn launch_tile_order(gpu: &Gpu, lists: &DeviceLists, tiles: usize) -> Buffer<u32> {
    let pairs = Pairs { keys: Buffer::new(gpu, tiles), values: Buffer::new(gpu, tiles) };
    let (grid, dim) = elementwise(tiles);
    // SAFETY: every access is guarded by the number of tiles.
    unsafe {
        blend_tile_lengths_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            lists.tile_start.arg(),
            pairs.keys.arg(),
            pairs.values.arg(),
            tiles as u32,
        );
    }
    launch_sort(gpu, pairs, quads_forward::LENGTH_BITS).values
}

/// The slots by the lengths of their buckets, the longest first.
pub(super) fn launch_order(gpu: &Gpu, lists: &DeviceLists, tiles: usize, shape: Shape) -> Buffer<u32> {
    let slots = slots(lists, tiles, shape);
    let pairs = Pairs { keys: Buffer::with_headroom(gpu, slots), values: Buffer::with_headroom(gpu, slots) };
    let (grid, dim) = elementwise(slots);
    // SAFETY: every access is guarded by the number of slots; tiles have their places in the lists.
    unsafe {
        blend_lengths_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            lists.tile_start.arg(),
            pairs.keys.arg(),
            pairs.values.arg(),
            tiles as u32,
            slots as u32,
            shape,
        );
    }
    launch_sort(gpu, pairs, LENGTH_BITS).values
}
