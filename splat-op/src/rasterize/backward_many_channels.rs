//! Backward kernel over the layers of a bucket, for many channels. A cube takes one block of pixels after another.
//! First its units are pixels: they go forwards through the bucket for `α` and `T`, then backwards for `∂L/∂α`, and
//! store both in shared memory. Then its units are Gaussians: they read the same values transposed, and each adds up
//! its own row over the pixels. A row's sums therefore need neither atomics nor shuffles, whatever the number of
//! channels.

use cubecl::prelude::*;

use super::backward::{MOMENTS, plane_of, row_len, tile_of_bucket};
use super::layer::{BUCKET, FOOTPRINT, KernelShape, LayerEllipse, Limits, colour, first_bucket, layer};
use crate::gpu::atomic::FloatCell;
use crate::intersect::forward::TileFrame;
use crate::intersect::{TILE, TILE_PIXELS};

/// Computes the rows of each bucket's intersections. `units`, a multiple of 32, is the number of units of a cube and
/// the number of pixels in a block.
///
/// Without `add`, every intersection's row is written to `rows`, `[H, row]`. With `add`, rows are added to `sums`, one
/// row per Gaussian.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_many_channels_kernel<A: FloatCell>(
    projected: &[f32],
    features: &[f32],
    grad: &[f32],
    tile_start: &[u32],
    intersection_of_place: &[u32],
    gaussian_of_intersection: &[u32],
    kept: &[f32],
    bucket_count: &[u32],
    suffix_rho: &[f32],
    rows: &mut [f32],
    sums: &[A],
    frame: TileFrame,
    limits: Limits,
    max_buckets: u32,
    #[comptime] shape: KernelShape,
    #[comptime] absolute: bool,
    #[comptime] add: bool,
    #[comptime] units: usize,
) {
    let channels = comptime!(shape.channels());
    let numbers = comptime!(shape.kept());
    let columns = comptime!(row_len(shape, absolute));
    // One more than the pixels of a block, so that neither direction of reading has bank conflicts.
    let stride = comptime!(units + 1);
    let parts = comptime!(units / BUCKET);
    let mut footprints = Shared::<[f32]>::new_slice(comptime!(BUCKET * FOOTPRINT));
    let mut alphas = Shared::<[f32]>::new_slice(comptime!(BUCKET * stride));
    let mut weights = Shared::<[f32]>::new_slice(comptime!(BUCKET * stride));

    let bucket_index = CUBE_POS as u32;
    let unit = UNIT_POS;
    let tiles = frame.tiles_x * frame.tiles_y;
    if bucket_index < max_buckets {
        let tile = tile_of_bucket(tile_start, tiles, bucket_index);
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        let bucket = bucket_index - first_bucket(first, tile);
        let place = bucket * comptime!(BUCKET as u32);
        if place < places {
            let count = min(places - place, comptime!(BUCKET as u32));
            let lane = unit % comptime!(BUCKET as u32);
            let part = unit / comptime!(BUCKET as u32);
            let mut intersection = 0u32;
            let mut gaussian = 0u32;
            if lane < count {
                intersection = intersection_of_place[(first + place + lane) as usize];
                gaussian = gaussian_of_intersection[intersection as usize];
            }
            let mut row = Array::<f32>::new(columns);
            for column in 0..columns {
                row[column] = 0.0f32;
            }
            if bucket < bucket_count[tile as usize] {
                if unit < count {
                    LayerEllipse::of(projected, gaussian as usize).store(&mut footprints, unit as usize);
                }
                sync_cube();
                let origin_x = tile % frame.tiles_x * comptime!(TILE as u32);
                let origin_y = tile / frame.tiles_x * comptime!(TILE as u32);
                let plane = (frame.width * frame.height) as usize;
                let at = bucket_index as usize * comptime!(numbers * TILE_PIXELS);

                for block in 0..comptime!((TILE_PIXELS / units) as u32) {
                    // The units are pixels.
                    let pixel = block * comptime!(units as u32) + unit;
                    let column = origin_x + pixel % comptime!(TILE as u32);
                    let line = origin_y + pixel / comptime!(TILE as u32);
                    let x = f32::cast_from(column) + 0.5;
                    let own_row = pixel / comptime!(TILE as u32);
                    let top = f32::cast_from(origin_y) + 0.5;
                    let inside = column < frame.width && line < frame.height;
                    let in_picture = (line * frame.width + column) as usize;
                    let before = kept[at + pixel as usize];
                    let mut through = select(before >= 0.0, 1.0f32, -1.0f32);
                    let mut stopped = 0.0f32;
                    for i in 0..count {
                        let mut alpha = 0.0f32;
                        if through >= 0.0 {
                            let footprint = LayerEllipse::load(&footprints, i as usize);
                            let (u, v) = footprint.whiten(x, top, f32::cast_from(own_row));
                            let value = footprint.alpha(u, v, frame.alpha_min, limits.alpha_max, shape);
                            let (contributes, next, stops) =
                                layer(value, through, stopped, before, limits.transmittance_min);
                            alpha = contributes;
                            weights[i as usize * stride + unit as usize] = alpha * (before * through);
                            through = next;
                            stopped = stops;
                        }
                        alphas[i as usize * stride + unit as usize] = alpha;
                    }
                    let mut grad_alpha = 0.0f32;
                    if comptime!(shape.grad_alpha) && inside {
                        grad_alpha = grad[comptime!(shape.features) * plane + in_picture];
                    }
                    let mut rho = suffix_rho[bucket_index as usize * comptime!(TILE_PIXELS) + pixel as usize];
                    for step in 0..count {
                        let i = (count - 1 - step) as usize;
                        let alpha = alphas[i * stride + unit as usize];
                        if alpha > 0.0 {
                            let mut along = grad_alpha;
                            let there = gaussian_of_intersection
                                [intersection_of_place[(first + place) as usize + i] as usize]
                                as usize;
                            for channel in 0..channels {
                                along += grad[plane_of(channel, shape) * plane + in_picture]
                                    * colour(projected, features, there, channel, shape);
                            }
                            let ahead = along - rho;
                            rho += alpha * ahead;
                            // From here on `alphas` holds `h`, and a pixel without an alpha has a weight of zero.
                            let mut h = 0.0f32;
                            if alpha < limits.alpha_max {
                                h = weights[i * stride + unit as usize] * ahead;
                            }
                            alphas[i * stride + unit as usize] = h;
                        } else {
                            weights[i * stride + unit as usize] = 0.0f32;
                        }
                    }
                    sync_cube();

                    // The units are Gaussians, each with a part of the pixels.
                    if lane < count {
                        let footprint = LayerEllipse::load(&footprints, lane as usize);
                        let slope = footprint.inverse_v * footprint.shear;
                        for step in 0..comptime!(BUCKET as u32) {
                            let other = part * comptime!(BUCKET as u32) + step;
                            let index = lane as usize * stride + other as usize;
                            let weight = weights[index];
                            if weight != 0.0 {
                                let pixel = block * comptime!(units as u32) + other;
                                let column = origin_x + pixel % comptime!(TILE as u32);
                                let own_row = pixel / comptime!(TILE as u32);
                                let line = origin_y + own_row;
                                let x = f32::cast_from(column) + 0.5;
                                let top = f32::cast_from(origin_y) + 0.5;
                                let (u, v) = footprint.whiten(x, top, f32::cast_from(own_row));
                                let h = alphas[index];
                                let hu = h * u;
                                let hv = h * v;
                                row[0] += h;
                                row[1] += hu;
                                row[2] += hv;
                                row[3] += hu * u;
                                row[4] += hu * v;
                                row[5] += hv * v;
                                let in_picture = (line * frame.width + column) as usize;
                                for channel in 0..channels {
                                    row[comptime!(MOMENTS) + channel] +=
                                        weight * grad[plane_of(channel, shape) * plane + in_picture];
                                }
                                if comptime!(absolute) {
                                    row[comptime!(MOMENTS + channels)] += (hu * footprint.inverse_u - hv * slope).abs();
                                    row[comptime!(MOMENTS + channels + 1)] += (hv * footprint.inverse_v).abs();
                                }
                            }
                        }
                    }
                    sync_cube();
                }

                // Adds up the parts of each row.
                if comptime!(parts > 1) {
                    for column in 0..columns {
                        alphas[unit as usize] = row[column];
                        sync_cube();
                        if part == 0 {
                            for other in 1..comptime!(parts as u32) {
                                row[column] += alphas[(other * comptime!(BUCKET as u32) + lane) as usize];
                            }
                        }
                        sync_cube();
                    }
                }
            }
            if part == 0 && lane < count {
                if comptime!(add) {
                    for column in 0..columns {
                        if row[column] != 0.0 {
                            A::add(&sums[gaussian as usize * columns + column], row[column]);
                        }
                    }
                } else {
                    for column in 0..columns {
                        rows[intersection as usize * columns + column] = row[column];
                    }
                }
            }
        }
    }
}
