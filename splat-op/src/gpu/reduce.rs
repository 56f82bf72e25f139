//! Sums over the units of a cube.
//!
//! They go through shared memory. Plane (subgroup) operations would save two barriers of a cube in kernels that have other work,
//! promise no order of units, and be a second form of every kernel.

use cubecl::prelude::*;

use super::math::Vec3;
use super::{Buffer, Gpu, UNITS, launch_unchecked};

/// Number of neighbouring units whose values are added first.
const GROUP: usize = 16;

/// Numbers of shared memory that [`cube_exclusive_sum`] needs.
pub(crate) const SUM_ROOM: usize = UNITS + UNITS / GROUP;

/// Waits for the units of the plane if `planes` is set, otherwise for those of the cube.
#[cube]
pub(crate) fn wait(#[comptime] planes: bool) {
    if comptime!(planes) {
        sync_plane();
    } else {
        sync_cube();
    }
}

/// Returns the sum of the values of all previous units, in the order of `UNIT_POS`, and the sum over all units, in a cube of
/// [`UNITS`] units. The sums must fit into u32. `shared` holds [`SUM_ROOM`] numbers.
///
/// A unit reads the 16 values of its group and the 16 sums of groups, which neighbouring units read at the same time, between
/// three barriers.
#[cube]
pub(crate) fn cube_exclusive_sum(value: u32, shared: &mut Shared<[u32]>) -> (u32, u32) {
    let unit = UNIT_POS as usize;
    let group = unit / comptime!(GROUP);
    shared[unit] = value;
    sync_cube();
    let mut before = 0u32;
    let mut of_group = 0u32;
    #[unroll]
    for i in 0..comptime!(GROUP) {
        let here = shared[group * comptime!(GROUP) + i];
        before += select(i < unit % comptime!(GROUP), here, 0);
        of_group += here;
    }
    if unit == group * comptime!(GROUP) {
        shared[comptime!(UNITS) + group] = of_group;
    }
    sync_cube();
    let mut total = 0u32;
    #[unroll]
    for other in 0..comptime!(UNITS / GROUP) {
        let here = shared[comptime!(UNITS) + other];
        before += select(other < group, here, 0);
        total += here;
    }
    sync_cube();
    (before, total)
}

/// Returns the sum of the values of all units in a cube of [`UNITS`] units. The result is the same in every unit, in every run
/// and on every device. `shared` holds [`UNITS`] numbers.
#[cube]
pub(crate) fn cube_sum(value: f32, shared: &mut Shared<[f32]>) -> f32 {
    let unit = UNIT_POS as usize;
    shared[unit] = value;
    sync_cube();
    let mut group_total = 0.0f32;
    if unit < comptime!(UNITS / GROUP) {
        for i in 0..comptime!(GROUP) {
            group_total += shared[unit * comptime!(GROUP) + i];
        }
    }
    sync_cube();
    if unit < comptime!(UNITS / GROUP) {
        shared[unit] = group_total;
    }
    sync_cube();
    let mut total = 0.0f32;
    for i in 0..comptime!(UNITS / GROUP) {
        total += shared[i];
    }
    sync_cube();
    total
}

/// Returns the sum of the vectors of all units in a cube; see [`cube_sum`].
#[cube]
pub(crate) fn cube_vector_sum(value: Vec3, shared: &mut Shared<[f32]>) -> Vec3 {
    let x = cube_sum(value.x, shared);
    let y = cube_sum(value.y, shared);
    let z = cube_sum(value.z, shared);
    Vec3::new(x, y, z)
}

/// Computes `sums[column] = Σ values[row][column]`, or `Σ weights[row] values[column][row]` if there are weights; a cube
/// per column, in a fixed order.
#[cube(launch_unchecked)]
fn column_sums_kernel(values: &[f32], weights: ComptimeOption<Box<[f32]>>, sums: &mut [f32], rows: u32, columns: u32) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS < columns as usize {
        let mut own = 0.0f32;
        let mut row = UNIT_POS;
        while row < rows {
            #[comptime]
            match &weights {
                ComptimeOption::Some(weights) => {
                    own += values[CUBE_POS * rows as usize + row as usize] * weights[row as usize];
                }
                ComptimeOption::None => own += values[row as usize * columns as usize + CUBE_POS],
            }
            row += comptime!(UNITS as u32);
        }
        let total = cube_sum(own, &mut shared);
        if UNIT_POS == 0 {
            sums[CUBE_POS] = total;
        }
    }
}

/// Returns the sums of the columns of `rows`, `[count, columns]`.
pub(crate) fn launch_column_sums(gpu: &Gpu, rows: &Buffer<f32>, columns: usize) -> Buffer<f32> {
    launch_sums(gpu, rows, None, [rows.len / columns, columns])
}

/// Returns the sums of the columns of `values`, `[rows, columns]`, or their weighted sums if `values` is `[columns, rows]`.
pub(crate) fn launch_sums(
    gpu: &Gpu,
    values: &Buffer<f32>,
    weights: Option<&Buffer<f32>>,
    [rows, columns]: [usize; 2],
) -> Buffer<f32> {
    let sums = Buffer::new(gpu, columns);
    // SAFETY: every access is guarded by the lengths given.
    launch_unchecked!(gpu.cubes(columns), column_sums_kernel(values, weights, &sums, rows, columns));
    sums
}
