//! Sums over the units of a cube.

use cubecl::prelude::*;

use super::{Buffer, Gpu, UNITS, cubes};

/// Number of units whose partial sums one unit adds, on the path through shared memory.
const GROUP: usize = 16;

/// Returns the sum of the values of all previous units and the sum over all units, in a cube of [`UNITS`] units. `shared` holds
/// `UNITS + 1` numbers. The sums saturate instead of wrapping, so that a total too large for u32 shows as its maximum.
#[cube]
pub(crate) fn cube_exclusive_sum(value: u32, shared: &mut Shared<[u32]>, #[comptime] planes: bool) -> (u32, u32) {
    let unit = UNIT_POS as usize;
    let mut before = value;
    if comptime!(planes) {
        let plane = UNIT_POS / PLANE_DIM;
        let count = (PLANE_DIM + comptime!(UNITS as u32 - 1)) / PLANE_DIM;
        // Sums of halves of the values stay far below 2^32, where sums of the values would wrap.
        let (high, low) = (before >> 16, before & 0xffff);
        let (high_sum, low_sum) = (plane_inclusive_sum(high), plane_inclusive_sum(low));
        // The last unit of a plane holds its total.
        if UNIT_POS_PLANE == PLANE_DIM - 1 {
            shared[plane as usize] = joined(high_sum, low_sum);
        }
        sync_cube();
        before = joined(high_sum - high, low_sum - low);
        let mut total = 0u32;
        for other in 0..count {
            if other == plane {
                before = saturating(before, total);
            }
            total = saturating(total, shared[other as usize]);
        }
        if unit == 0 {
            shared[comptime!(UNITS)] = total;
        }
    } else {
        shared[unit] = value;
        sync_cube();
        // Each of the first units turns a group into its prefix sums; the sum of the group is then stored under the index of
        // the group.
        let mut group_total = 0u32;
        if unit < comptime!(UNITS / GROUP) {
            for i in 0..comptime!(GROUP) {
                let here = shared[unit * comptime!(GROUP) + i];
                shared[unit * comptime!(GROUP) + i] = group_total;
                group_total = saturating(group_total, here);
            }
        }
        sync_cube();
        before = shared[unit];
        sync_cube();
        if unit < comptime!(UNITS / GROUP) {
            shared[unit] = group_total;
        }
        sync_cube();
        if unit == 0 {
            let mut total = 0u32;
            for i in 0..comptime!(UNITS / GROUP) {
                let here = shared[i];
                shared[i] = total;
                total = saturating(total, here);
            }
            shared[comptime!(UNITS)] = total;
        }
        sync_cube();
        before = saturating(before, shared[unit / comptime!(GROUP)]);
    }
    sync_cube();
    let total = shared[comptime!(UNITS)];
    sync_cube();
    (before, total)
}

/// Returns `2^16 high + low`, limited to the largest u32.
#[cube]
fn joined(high: u32, low: u32) -> u32 {
    let high = high + (low >> 16);
    select(high > 0xffff, 4_294_967_295u32, (high << 16) | (low & 0xffff))
}

/// Returns `a + b`, limited to the largest u32.
#[cube]
pub(crate) fn saturating(a: u32, b: u32) -> u32 {
    a + min(b, 4_294_967_295u32 - a)
}

/// Returns the sum of the values of all units in a cube of [`UNITS`] units. The result is the same in every unit and in every
/// run. `shared` holds [`UNITS`] numbers.
#[cube]
pub(crate) fn cube_sum(value: f32, shared: &mut Shared<[f32]>, #[comptime] planes: bool) -> f32 {
    let unit = UNIT_POS as usize;
    let mut total = 0.0f32;
    if comptime!(planes) {
        let sum = plane_sum(value);
        if UNIT_POS_PLANE == 0 {
            shared[(UNIT_POS / PLANE_DIM) as usize] = sum;
        }
        sync_cube();
        for plane in 0..(PLANE_DIM + comptime!(UNITS as u32 - 1)) / PLANE_DIM {
            total += shared[plane as usize];
        }
    } else {
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
        for i in 0..comptime!(UNITS / GROUP) {
            total += shared[i];
        }
    }
    sync_cube();
    total
}

/// Computes `sums[column] = Σ values[row][column]`, or `Σ weights[row] values[column][row]` if there are weights; a cube
/// per column, in a fixed order.
#[cube(launch_unchecked)]
fn column_sums_kernel(
    values: &[f32],
    weights: ComptimeOption<Box<[f32]>>,
    sums: &mut [f32],
    rows: u32,
    columns: u32,
    #[comptime] planes: bool,
) {
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
        let total = cube_sum(own, &mut shared, planes);
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
    unsafe {
        column_sums_kernel::launch_unchecked(
            &gpu.client,
            cubes(columns),
            CubeDim::new_1d(UNITS as u32),
            values.arg(),
            weights.map(Buffer::arg).into(),
            sums.arg(),
            rows as u32,
            columns as u32,
            gpu.planes,
        );
    }
    sums
}
