//! Backward kernel over the layers of a bucket, for many channels. A cube takes one block of pixels after another.
//! First its units are pixels: they go forwards through the bucket for `α` and `T`, then backwards for `∂L/∂α`, and
//! store both in shared memory. Then its units are Gaussians: they read the same values transposed, and each adds up
//! its own row over the pixels. A row's sums therefore need neither atomics nor shuffles, whatever the number of
//! channels.

use cubecl::prelude::*;

use super::backward::{MOMENTS, plane_of, row_len, tile_of};
use super::layer::{
    BUCKET, FOOTPRINT, KernelShape, LayerEllipse, RasterFrame, TilePixel, colour, first_bucket, layer, tile_origin,
};
use crate::gpu::atomic::FloatCell;
use crate::intersect::TILE_PIXELS;
use crate::intersect::forward::TileLists;

/// Number of units of a cube and of pixels in a block, a multiple of 32. Two arrays of 32 numbers per unit leave room for
/// no more in 32 KiB of shared memory.
pub(super) const MANY_UNITS: usize = 64;

/// Computes the rows of each bucket's intersections.
///
/// Without `add`, every intersection's row is written to `rows`, `[H, row]`. With `add`, rows are added to `sums`, one
/// row per Gaussian.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_many_channels_kernel<A: FloatCell>(
    projected: &[f32],
    features: &[f32],
    grad: &[f32],
    lists: TileLists,
    kept: &[f32],
    bucket_count: &[u32],
    suffix_rho: &[f32],
    rows: &mut [f32],
    sums: &[A],
    frame: RasterFrame,
    max_buckets: u32,
    #[comptime] shape: KernelShape,
    #[comptime] absolute: bool,
    #[comptime] add: bool,
) {
    let units = comptime!(MANY_UNITS);
    let channels = comptime!(shape.channels());
    let numbers = comptime!(shape.kept());
    let columns = comptime!(row_len(shape, absolute));
    // One more than the pixels of a block, so that neither direction of reading has bank conflicts.
    let stride = comptime!(units + 1);
    let mut footprints = Shared::<[f32]>::new_slice(comptime!(BUCKET * FOOTPRINT));
    let mut alphas = Shared::<[f32]>::new_slice(comptime!(BUCKET * stride));
    let mut weights = Shared::<[f32]>::new_slice(comptime!(BUCKET * stride));

    let bucket_index = CUBE_POS as u32;
    let unit = UNIT_POS;
    if bucket_index < max_buckets {
        let tile = tile_of(&lists, 0, frame.tiles_x * frame.tiles_y, bucket_index, true);
        let first = lists.start(tile);
        let places = lists.start(tile + 1) - first;
        let bucket = bucket_index - first_bucket(first, tile);
        let place = bucket * comptime!(BUCKET as u32);
        if place < places {
            let count = min(places - place, comptime!(BUCKET as u32));
            let lane = unit % comptime!(BUCKET as u32);
            let part = unit / comptime!(BUCKET as u32);
            let mut intersection = 0u32;
            let mut gaussian = 0u32;
            if lane < count {
                intersection = lists.intersection(first + place + lane);
                gaussian = lists.gaussian_of_intersection[intersection as usize];
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
                let origin = tile_origin(tile, &frame);
                let plane = (frame.width * frame.height) as usize;
                let at = bucket_index as usize * comptime!(numbers * TILE_PIXELS);

                for block in 0..comptime!((TILE_PIXELS / units) as u32) {
                    // The units are pixels.
                    let in_tile = block * comptime!(units as u32) + unit;
                    let pixel = TilePixel::of(origin, in_tile, &frame);
                    let before = kept[at + in_tile as usize];
                    let mut through = select(before >= 0.0, 1.0f32, -1.0f32);
                    let mut stopped = 0.0f32;
                    for i in 0..count {
                        let mut alpha = 0.0f32;
                        if through >= 0.0 {
                            let footprint = LayerEllipse::load(&footprints, i as usize);
                            let (u, v) = footprint.whiten(pixel.x, pixel.top, pixel.row);
                            let value = footprint.alpha(u, v, &frame, shape);
                            let (contributes, next, stops) =
                                layer(value, through, stopped, before, frame.transmittance_min);
                            alpha = contributes;
                            weights[i as usize * stride + unit as usize] = alpha * (before * through);
                            through = next;
                            stopped = stops;
                        }
                        alphas[i as usize * stride + unit as usize] = alpha;
                    }
                    let mut grad_alpha = 0.0f32;
                    if comptime!(shape.grad_alpha) && pixel.inside {
                        grad_alpha = grad[comptime!(shape.features) * plane + pixel.index];
                    }
                    let mut rho = suffix_rho[bucket_index as usize * comptime!(TILE_PIXELS) + in_tile as usize];
                    for step in 0..count {
                        let i = (count - 1 - step) as usize;
                        let alpha = alphas[i * stride + unit as usize];
                        if alpha > 0.0 {
                            let mut along = grad_alpha;
                            let there = lists.gaussian(first + place + i as u32) as usize;
                            for channel in 0..channels {
                                along += grad[plane_of(channel, shape) * plane + pixel.index]
                                    * colour(projected, features, there, channel, shape);
                            }
                            let ahead = along - rho;
                            rho += alpha * ahead;
                            // From here on `alphas` holds `h`, and a pixel without an alpha has a weight of zero.
                            let mut h = 0.0f32;
                            if alpha < frame.alpha_max {
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
                                let pixel = TilePixel::of(origin, block * comptime!(units as u32) + other, &frame);
                                let (u, v) = footprint.whiten(pixel.x, pixel.top, pixel.row);
                                let h = alphas[index];
                                let hu = h * u;
                                let hv = h * v;
                                row[0] += h;
                                row[1] += hu;
                                row[2] += hv;
                                row[3] += hu * u;
                                row[4] += hu * v;
                                row[5] += hv * v;
                                for channel in 0..channels {
                                    row[comptime!(MOMENTS) + channel] +=
                                        weight * grad[plane_of(channel, shape) * plane + pixel.index];
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
                for column in 0..columns {
                    alphas[unit as usize] = row[column];
                    sync_cube();
                    if part == 0 {
                        for other in 1..comptime!((MANY_UNITS / BUCKET) as u32) {
                            row[column] += alphas[(other * comptime!(BUCKET as u32) + lane) as usize];
                        }
                    }
                    sync_cube();
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
