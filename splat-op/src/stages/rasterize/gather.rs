//! Last kernel of the backward pass: rows of sums to gradients.

use cubecl::prelude::*;

use super::MOMENTS;
use super::layer::KernelShape;
use crate::project::COLUMNS;
use crate::ray_space::SLOPES;

/// Stores the gradient of the shape of the ellipse that begins at `at`, from its moments. One that is not `shown` has zeros, which
/// nothing is divided by.
#[cube]
fn store_shape(out: &mut [f32], to: usize, row: &Array<f32>, projected: &[f32], at: usize, shown: bool) {
    let sigma_u = select(shown, projected[at + 2], 1.0);
    let shear = select(shown, projected[at + 3], 0.0);
    let sigma_v = select(shown, projected[at + 4], 1.0);
    let per_v = row[2] / sigma_v;
    out[to] = row[1] / sigma_u - shear * per_v;
    out[to + 1] = per_v;
    out[to + 2] = row[3] / sigma_u;
    out[to + 3] = row[4] * (sigma_u / sigma_v);
    out[to + 4] = row[5] / sigma_v;
}

/// Turns rows into gradients. With `e = −(u² + v²)/2`: `∂e/∂sigma_u = u²/sigma_u`, `∂e/∂sigma_v = v²/sigma_v`,
/// `∂e/∂shear = u v sigma_u/sigma_v`, `∂e/∂mean = (u/sigma_u − v shear/sigma_v, v/sigma_v)`; and `∂α/∂opacity = α/opacity`.
///
/// With `per_intersection`, the Gaussians have the ranks `first_rank..end_rank` in `order`, and `rows` holds the rows of their
/// intersections, `first_row..end_row`; the gradients of other Gaussians are not written: the buffers must hold zeros. Otherwise
/// `rows` holds a row for each Gaussian of the scene, in whose order neighbouring units read neighbouring rows, and every gradient
/// is written: zeros for a row of zeros.
///
/// A row has the moments, the channels, along rays the gradient of the depth slope and of the centre's relative depth, and in the
/// last two columns the sums of absolute values, if they are wanted.
///
/// With `grad_rays` the Gaussian was seen along rays: the gradient of its shape goes to its row of `ray_space`, which has
/// `ray_columns` columns, and the ellipse keeps that of its opacity.
#[cube(launch_unchecked)]
pub(super) fn rasterize_gather_kernel(
    projected: &[f32],
    order: &[u32],
    first_intersection: &[u32],
    rows: &[f32],
    mut grad_projected: ComptimeOption<Box<[f32]>>,
    mut grad_features: ComptimeOption<Box<[f32]>>,
    mut grad_absolute: ComptimeOption<Box<[f32]>>,
    mut grad_rays: ComptimeOption<Box<[f32]>>,
    first_rank: u32,
    end_rank: u32,
    first_row: u32,
    end_row: u32,
    #[comptime] shape: KernelShape,
    #[comptime] columns: usize,
    #[comptime] ray_columns: usize,
    #[comptime] per_intersection: bool,
    #[comptime] _given: u32,
) {
    let held = comptime!(shape.held());
    let rank = first_rank as usize + ABSOLUTE_POS;
    if rank < end_rank as usize {
        let mut gaussian = rank;
        let mut row = Array::<f32>::new(columns);
        if comptime!(per_intersection) {
            gaussian = order[rank] as usize;
            let first = first_intersection[rank];
            let mut end = end_row;
            if rank + 1 < end_rank as usize {
                end = first_intersection[rank + 1];
            }
            #[unroll(held)]
            for column in 0..columns {
                row[column] = 0.0f32;
            }
            for row_index in first - first_row..end - first_row {
                #[unroll(held)]
                for column in 0..columns {
                    row[column] += rows[row_index as usize * columns + column];
                }
            }
        } else {
            #[unroll(held)]
            for column in 0..columns {
                row[column] = rows[gaussian * columns + column];
            }
        }
        let mut set = 0u32;
        #[unroll(held)]
        for column in 0..columns {
            set |= u32::reinterpret(row[column]);
        }
        let shown = (set & 0x7fff_ffff) != 0;
        let at = gaussian * comptime!(COLUMNS);
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_rays {
            let first = gaussian * ray_columns;
            #[unroll]
            for k in 0..comptime!(SLOPES) {
                out[first + k] = row[comptime!(MOMENTS + shape.channels() + k)];
            }
            store_shape(out, first + comptime!(SLOPES), &row, projected, at, shown);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_projected {
            if comptime!(ray_columns == 0) {
                store_shape(out, at, &row, projected, at, shown);
            } else {
                #[unroll]
                for column in 0..5usize {
                    out[at + column] = 0.0f32;
                }
            }
            let mut depth = 0.0f32;
            if comptime!(ray_columns == 0 && shape.depth) {
                depth = row[comptime!(MOMENTS + shape.features)];
            }
            out[at + 5] = depth;
            out[at + 6] = row[0] / select(shown, projected[at + 6], 1.0);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_features {
            #[unroll(held)]
            for channel in 0..comptime!(shape.features) {
                out[gaussian * comptime!(shape.features) + channel] = row[comptime!(MOMENTS) + channel];
            }
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_absolute {
            out[2 * gaussian] = row[comptime!(columns - 2)];
            out[2 * gaussian + 1] = row[comptime!(columns - 1)];
        }
    }
}
