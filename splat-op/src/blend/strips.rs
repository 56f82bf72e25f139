//! The layers of a bucket, backwards, for few channels on a graphics card: a unit per strip of pixels, a column and some rows
//! of a tile, whose numbers stay in registers.
//!
//! A cube takes a bucket four places at a time, from the last to the first. `α` and `T` of the four come from a forward
//! pass through the whole bucket, which leaves `T` before each four, and from the four once more: twice the exponentials,
//! but neither a division by `1 − α` nor a store per pixel and place. Sums over a unit's pixels stay in registers; only the
//! units' sums meet, in shared memory, once per four places. A tree of pairs of Gaussians and pixels the other way round
//! (`channels.rs`) passes eleven numbers through shared memory for each pair, this one three for each eighth.

use cubecl::prelude::*;

use super::backward::{MOMENTS, plane_of, row_len, tile_of_slot};
use super::layer::{
    BUCKET, Block, FOOTPRINT, Footprint, Limits, Shape, block_origin, checkpoint, colour, first_slot, layer, restore,
};
use crate::gpu::atomic::FloatCell;
use crate::tile::forward::Frame;
use crate::tile::{TILE, TILE_PIXELS};

/// Places that are worked on at once. Their alphas and weights lie in registers.
const STEP: usize = 4;

/// Rows of the hits of each bucket.
///
/// `rows` is `[H, row]` and every hit's row is written, or, with `add`, one row per Gaussian that is added to in `sums`.
#[cube(launch_unchecked)]
pub(super) fn blend_strips_kernel<A: FloatCell>(
    projected: &[f32],
    features: &[f32],
    grad: &[f32],
    tile_start: &[u32],
    hit_of_place: &[u32],
    gaussian_of_hit: &[u32],
    kept: &[f32],
    passed: &[u32],
    rho_behind: &[f32],
    rows: &mut [f32],
    sums: &[A],
    frame: Frame,
    limits: Limits,
    slots: u32,
    #[comptime] shape: Shape,
    #[comptime] absolute: bool,
    #[comptime] add: bool,
    #[comptime] block: Block,
) {
    let channels = comptime!(shape.channels());
    let columns = comptime!(row_len(shape, absolute));
    let units = comptime!(block.of_tile());
    let (lines, pixels) = comptime!((block.down, block.pixels()));
    let mut footprints = Shared::<[f32]>::new_slice(comptime!(BUCKET * FOOTPRINT));
    let mut colours = Shared::<[f32]>::new_slice(comptime!(BUCKET * channels));
    let mut hits = Shared::<[u32]>::new_slice(comptime!(BUCKET));
    let mut partial = Shared::<[f32]>::new_slice(comptime!(STEP * columns * (units + 1)));

    let slot = CUBE_POS as u32;
    if slot < slots {
        let tile = tile_of_slot(tile_start, frame.tiles_x * frame.tiles_y, slot, shape);
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        let bucket = slot - first_slot(first, tile, shape);
        let place = bucket * comptime!(BUCKET as u32);
        if place < places {
            let count = min(places - place, comptime!(BUCKET as u32));
            let steps = (count + comptime!(STEP as u32 - 1)) / comptime!(STEP as u32);
            let mut i = UNIT_POS;
            while i < steps * comptime!(STEP as u32) {
                let mut hit = 0u32;
                let mut gaussian = 0u32;
                if i < count {
                    hit = hit_of_place[(first + place + i) as usize];
                    gaussian = gaussian_of_hit[hit as usize];
                    Footprint::of(projected, gaussian as usize).store(&mut footprints, i as usize);
                } else {
                    Footprint::nowhere().store(&mut footprints, i as usize);
                }
                hits[i as usize] = if comptime!(add) { gaussian } else { hit };
                #[unroll]
                for channel in 0..channels {
                    // Beside the last hit there is nothing; the colour of some Gaussian, times zero, may still be NaN.
                    let value = colour(projected, features, gaussian as usize, channel, shape);
                    colours[i as usize * channels + channel] = select(i < count, value, 0.0f32);
                }
                i += comptime!(units as u32);
            }
            sync_cube();

            if bucket >= passed[tile as usize] {
                if comptime!(!add) {
                    let mut i = UNIT_POS;
                    while i < count * comptime!(columns as u32) {
                        let hit = hits[(i / comptime!(columns as u32)) as usize] as usize;
                        rows[hit * columns + (i % comptime!(columns as u32)) as usize] = 0.0f32;
                        i += comptime!(units as u32);
                    }
                }
            } else {
                let (column, row) = block_origin(UNIT_POS, block);
                let first_column = tile % frame.tiles_x * comptime!(TILE as u32) + column;
                let first_row = tile / frame.tiles_x * comptime!(TILE as u32) + row;
                let in_tile = (row * comptime!(TILE as u32) + column) as usize;
                let x = f32::cast_from(first_column) + 0.5;
                let top = f32::cast_from(first_row - row) + 0.5;
                let own_row = f32::cast_from(row);
                let plane = (frame.width * frame.height) as usize;
                let at = slot as usize * comptime!(shape.kept() * TILE_PIXELS) + in_tile;

                // What does not change from layer to layer.
                let mut before = Array::<f32>::new(pixels);
                let mut rho = Array::<f32>::new(pixels);
                let mut grad_alpha = Array::<f32>::new(pixels);
                let mut gradients = Array::<f32>::new(comptime!(pixels * channels));
                let mut through = Array::<f32>::new(pixels);
                let mut stopped = Array::<f32>::new(pixels);
                #[unroll]
                for p in 0..pixels {
                    let in_tile_too = comptime!(block.in_tile(p));
                    before[p] = kept[at + in_tile_too];
                    rho[p] = rho_behind[slot as usize * comptime!(TILE_PIXELS) + in_tile + in_tile_too];
                    grad_alpha[p] = 0.0f32;
                    #[unroll]
                    for channel in 0..channels {
                        gradients[comptime!(p * channels) + channel] = 0.0f32;
                    }
                    let column = first_column + comptime!(block.pixel(p)[0] as u32);
                    let line = first_row + comptime!(block.pixel(p)[1] as u32);
                    if column < frame.width && line < frame.height {
                        let pixel = (line * frame.width + column) as usize;
                        grad_alpha[p] = grad[comptime!(shape.features) * plane + pixel];
                        #[unroll]
                        for channel in 0..channels {
                            gradients[comptime!(p * channels) + channel] =
                                grad[plane_of(channel, shape) * plane + pixel];
                        }
                    }
                    through[p] = select(before[p] >= 0.0, 1.0f32, -1.0f32);
                    stopped[p] = 0.0f32;
                }

                // Forwards: what the layers before each step let through, and stop.
                let mut checkpoints = Array::<f32>::new(comptime!(BUCKET / STEP * pixels));
                for step in 0..steps {
                    let base = step as usize * pixels;
                    #[unroll]
                    for p in 0..pixels {
                        checkpoints[base + p] = checkpoint(through[p], stopped[p]);
                    }
                    // Nothing comes after the last.
                    let end = select(step + 1 < steps, (step + 1) * comptime!(STEP as u32), 0u32);
                    for i in step * comptime!(STEP as u32)..end {
                        let footprint = Footprint::load(&footprints, i as usize);
                        #[unroll]
                        for p in 0..pixels {
                            let (u, below) = footprint.along_column(x + comptime!(block.pixel(p)[0] as f32), top);
                            let v = (below + (own_row + comptime!(block.pixel(p)[1] as f32))) * footprint.inverse_v;
                            let alpha = footprint.alpha(u, v, frame.alpha_min, limits.alpha_max);
                            let (_, next, stops) =
                                layer(alpha, through[p], stopped[p], before[p], limits.transmittance_min);
                            stopped[p] = stops;
                            through[p] = next;
                        }
                    }
                }

                // Backwards.
                for back in 0..steps {
                    let step = steps - 1 - back;
                    let base = step as usize * pixels;
                    let start = step * comptime!(STEP as u32);
                    let mut alphas = Array::<f32>::new(comptime!(STEP * pixels));
                    let mut weights = Array::<f32>::new(comptime!(STEP * pixels));
                    #[unroll]
                    for p in 0..pixels {
                        let (open, stops) = restore(checkpoints[base + p]);
                        through[p] = open;
                        stopped[p] = stops;
                    }
                    #[unroll]
                    for k in 0..comptime!(STEP) {
                        let footprint = Footprint::load(&footprints, start as usize + k);
                        #[unroll]
                        for p in 0..pixels {
                            let (u, below) = footprint.along_column(x + comptime!(block.pixel(p)[0] as f32), top);
                            let v = (below + (own_row + comptime!(block.pixel(p)[1] as f32))) * footprint.inverse_v;
                            let alpha = footprint.alpha(u, v, frame.alpha_min, limits.alpha_max);
                            let (alpha, next, stops) =
                                layer(alpha, through[p], stopped[p], before[p], limits.transmittance_min);
                            stopped[p] = stops;
                            alphas[comptime!(k * pixels + p)] = alpha;
                            weights[comptime!(k * pixels + p)] = alpha * (before[p] * through[p]);
                            through[p] = next;
                        }
                    }
                    #[unroll]
                    for from_end in 0..comptime!(STEP) {
                        let k = comptime!(STEP - 1 - from_end);
                        let footprint = Footprint::load(&footprints, start as usize + k);
                        let slope = footprint.inverse_v * footprint.shear;
                        let mut own = Array::<f32>::new(columns);
                        #[unroll]
                        for column in 0..columns {
                            own[column] = 0.0f32;
                        }
                        #[unroll]
                        for across in 0..comptime!(block.across) {
                            let (u, below) = footprint.along_column(x + comptime!(across as f32), top);
                            // Sums of `h, h v, h v²` down the column, where `u` is the same.
                            let mut h_sum = 0.0f32;
                            let mut hv_sum = 0.0f32;
                            let mut hvv_sum = 0.0f32;
                            #[unroll]
                            for line in 0..lines {
                                let p = comptime!(across * lines + line);
                                let alpha = alphas[comptime!(k * pixels + p)];
                                let weight = weights[comptime!(k * pixels + p)];
                                let mut along = grad_alpha[p];
                                #[unroll]
                                for channel in 0..channels {
                                    along += gradients[comptime!(p * channels) + channel]
                                        * colours[(start as usize + k) * channels + channel];
                                    own[comptime!(MOMENTS) + channel] +=
                                        weight * gradients[comptime!(p * channels) + channel];
                                }
                                let ahead = along - rho[p];
                                rho[p] += alpha * ahead;
                                let h = select(alpha < limits.alpha_max, weight * ahead, 0.0);
                                let v = (below + (own_row + comptime!(line as f32))) * footprint.inverse_v;
                                let hv = h * v;
                                h_sum += h;
                                hv_sum += hv;
                                hvv_sum += hv * v;
                                if comptime!(absolute) {
                                    own[comptime!(MOMENTS + channels)] +=
                                        (h * u * footprint.inverse_u - hv * slope).abs();
                                    own[comptime!(MOMENTS + channels + 1)] += (hv * footprint.inverse_v).abs();
                                }
                            }
                            own[0] += h_sum;
                            own[1] += h_sum * u;
                            own[2] += hv_sum;
                            own[3] += h_sum * u * u;
                            own[4] += hv_sum * u;
                            own[5] += hvv_sum;
                        }
                        #[unroll]
                        for column in 0..columns {
                            partial[comptime!(k * columns) * comptime!(units + 1)
                                + column * comptime!(units + 1)
                                + UNIT_POS as usize] = own[column];
                        }
                    }
                    sync_cube();
                    let mut pair = UNIT_POS;
                    while pair < comptime!((STEP * columns) as u32) {
                        let i = start + pair / comptime!(columns as u32);
                        if i < count {
                            let mut sum = 0.0f32;
                            for unit in 0..units {
                                sum += partial[pair as usize * comptime!(units + 1) + unit];
                            }
                            let cell =
                                hits[i as usize] as usize * columns + (pair % comptime!(columns as u32)) as usize;
                            if comptime!(add) {
                                if sum != 0.0 {
                                    A::add(&sums[cell], sum);
                                }
                            } else {
                                rows[cell] = sum;
                            }
                        }
                        pair += comptime!(units as u32);
                    }
                    sync_cube();
                }
            }
        }
    }
}
