//! A pass of the radix sort on a driver in software: each unit by itself, with its counters in a private array. Such a driver
//! takes as long for one load or store of shared memory as for one of any other, and ten times as long as for one of a
//! private array; the cubes of `sort.rs` would spend most of a pass on their counters.

use cubecl::prelude::*;

use super::scan::launch_scan;
use super::sort::Pairs;
use crate::gpu::{Buffer, Gpu, cubes};

/// Bits of a digit at most.
pub(super) const BITS: u32 = 8;
const DIGITS: usize = 1 << BITS;

/// Units of a cube: one vector of the driver's.
const CUBE: usize = 8;

/// Units among which the keys are dealt out where there are many keys.
const SHARES: usize = 256;

/// A pass's keys and which of their bits it sorts by.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Pass {
    len: u32,
    /// Consecutive keys of a unit, and units.
    per_unit: u32,
    units: u32,
    /// Place of the lowest bit, and values of the digit.
    shift: u32,
    digits: u32,
}

#[cube]
impl Pass {
    fn digit(&self, key: u32) -> usize {
        ((key >> self.shift) & (self.digits - 1)) as usize
    }
}

/// `counts[digit][unit]`: keys of each unit by digit.
#[cube(launch_unchecked)]
fn count_alone_kernel(keys: &[u32], counts: &mut [u32], pass: Pass) {
    let unit = ABSOLUTE_POS as u32;
    if unit < pass.units {
        let mut counters = Array::<u32>::new(DIGITS);
        for digit in 0..pass.digits {
            counters[digit as usize] = 0u32;
        }
        for i in unit * pass.per_unit..min((unit + 1) * pass.per_unit, pass.len) {
            counters[pass.digit(keys[i as usize])] += 1u32;
        }
        for digit in 0..pass.digits {
            counts[(digit * pass.units + unit) as usize] = counters[digit as usize];
        }
    }
}

/// Writes each key and its value where `starts[digit][unit]` and the unit's keys before it say.
#[cube(launch_unchecked)]
fn scatter_alone_kernel(
    keys: &[u32],
    values: &[u32],
    starts: &[u32],
    sorted_keys: &mut [u32],
    sorted_values: &mut [u32],
    pass: Pass,
) {
    let unit = ABSOLUTE_POS as u32;
    if unit < pass.units {
        let mut places = Array::<u32>::new(DIGITS);
        for digit in 0..pass.digits {
            places[digit as usize] = starts[(digit * pass.units + unit) as usize];
        }
        for i in unit * pass.per_unit..min((unit + 1) * pass.per_unit, pass.len) {
            let key = keys[i as usize];
            let digit = pass.digit(key);
            let place = places[digit];
            places[digit] = place + 1u32;
            sorted_keys[place as usize] = key;
            sorted_values[place as usize] = values[i as usize];
        }
    }
}

/// One pass: sorts `from` by `bits` bits from `shift` on into `to`.
pub(super) fn launch_pass(gpu: &Gpu, from: &Pairs, to: &Pairs, shift: u32, bits: u32) {
    let (len, digits) = (from.keys.len, 1_usize << bits);
    // With fewer keys than this the counters would be most of the work.
    let per_unit = len.div_ceil(SHARES).max(2 * digits);
    let units = len.div_ceil(per_unit);
    let pass = || PassLaunch::new(len as u32, per_unit as u32, units as u32, shift, digits as u32);
    let counts = Buffer::new(gpu, digits * units);
    let (grid, dim) = (cubes(units.div_ceil(CUBE)), CubeDim::new_1d(CUBE as u32));
    // SAFETY: every access is guarded by the lengths given; places stay below `len` because they are a permutation.
    unsafe {
        count_alone_kernel::launch_unchecked(&gpu.client, grid, dim, from.keys.arg(), counts.arg(), pass());
    }
    launch_scan(gpu, &counts);
    let grid = cubes(units.div_ceil(CUBE));
    // SAFETY: as above.
    unsafe {
        scatter_alone_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            from.keys.arg(),
            from.values.arg(),
            counts.arg(),
            to.keys.arg(),
            to.values.arg(),
            pass(),
        );
    }
}
