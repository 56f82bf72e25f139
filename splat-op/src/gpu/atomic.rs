//! Atomic addition of floats into a buffer from many cubes.

use cubecl::prelude::*;

/// A cell that floats can be added to.
#[cube]
pub(crate) trait FloatCell: CubePrimitive {
    fn add(cell: &Self, value: f32);
}

#[cube]
impl FloatCell for Atomic<f32> {
    fn add(cell: &Self, value: f32) {
        cell.fetch_add(value);
    }
}

/// For devices without float atomics. A turn exchanges the cell's value for zero, adds that value to its own, and exchanges the
/// sum back into the cell; a value that another unit stored meanwhile is added in the next turn. Unlike a weak
/// compare-and-swap, which may fail in WGSL without reporting it, an exchange loses nothing.
#[cube]
impl FloatCell for Atomic<u32> {
    fn add(cell: &Self, value: f32) {
        let mut carried = value;
        let mut busy = true;
        while busy {
            let sum = f32::reinterpret(cell.exchange(0u32)) + carried;
            let displaced = cell.exchange(u32::reinterpret(sum));
            carried = f32::reinterpret(displaced);
            busy = (displaced & 0x7fff_ffff) != 0;
        }
    }
}
