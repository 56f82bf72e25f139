//! The layers of a bucket, backwards, for few channels on a driver in software: a unit per bucket.
//!
//! Such a driver runs eight units as one vector, but reads and writes memory for each of them one after the other, ten times
//! slower than it computes; private arrays are not much slower than registers. So units share nothing: each copies its
//! bucket's Gaussians and keeps their sums to itself, and goes through the tile block by block, passing only those that reach
//! the block. What each step does at a pixel is that of `strips.rs`.

use cubecl::prelude::*;

use super::backward::{MOMENTS, plane_of, row_len, tile_of_slot};
use super::layer::{
    Block, FOOTPRINT, Footprint, Limits, Shape, block_origin, checkpoint, colour, first_slot, layer, restore,
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
pub(super) fn blend_buckets_kernel<A: FloatCell>(
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
    let size = comptime!(shape.bucket);
    let pixels = comptime!(block.pixels());
    let numbers = comptime!(FOOTPRINT + channels);
    let slot = ABSOLUTE_POS as u32;
    if slot < slots {
        let tile = tile_of_slot(tile_start, frame.tiles_x * frame.tiles_y, slot, shape);
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        let bucket = slot - first_slot(first, tile, shape);
        let place = bucket * comptime!(size as u32);
        if place < places {
            let count = min(places - place, comptime!(size as u32));
            let tile_column = tile % frame.tiles_x * comptime!(TILE as u32);
            let tile_row = tile / frame.tiles_x * comptime!(TILE as u32);
            let left = f32::cast_from(tile_column) + 0.5;
            let top = f32::cast_from(tile_row) + 0.5;

            // An array for each number, of one more than there are places: the last shows nowhere. A driver's compiler takes
            // time with the square of the numbers that it sets to zero at once, so a loop follows each array.
            let mut gaussians = Array::<u32>::new(size);
            let mut i = 0u32;
            while i < count {
                gaussians[i as usize] = gaussian_of_hit[hit_of_place[(first + place + i) as usize] as usize];
                i += 1;
            }
            let mut splats = Sequence::<Array<f32>>::new();
            #[unroll]
            for number in 0..numbers {
                let mut values = Array::<f32>::new(comptime!(size + 1));
                values[size] = 0.0f32;
                let mut i = 0u32;
                while i < count {
                    let gaussian = gaussians[i as usize] as usize;
                    values[i as usize] = if comptime!(number < FOOTPRINT) {
                        Footprint::number(projected, gaussian, number)
                    } else {
                        colour(projected, features, gaussian, comptime!(number - FOOTPRINT), shape)
                    };
                    i += 1;
                }
                splats.push(values);
            }
            let mut own = Sequence::<Array<f32>>::new();
            #[unroll]
            for _ in 0..columns {
                let mut values = Array::<f32>::new(comptime!(size + 1));
                let mut i = 0u32;
                while i <= count {
                    values[i as usize] = 0.0f32;
                    i += 1;
                }
                own.push(values);
            }
            let mut reached = Array::<u32>::new(size);
            let skipped = bucket >= passed[tile as usize];
            let mut i = 0u32;
            while i < count {
                let footprint = Footprint::among(&splats, i as usize);
                let blocks = footprint.blocks_reached(left, top, frame.alpha_min, block);
                reached[i as usize] = select(skipped, 0u32, blocks);
                i += 1;
            }

            let mut index = 0u32;
            loop {
                let mut list = Array::<u32>::new(comptime!(size + STEP));
                let mut layers = 0u32;
                let mut i = 0u32;
                loop {
                    if (reached[i as usize] >> index & 1) != 0 {
                        list[layers as usize] = i;
                        layers += 1;
                    }
                    i += 1;
                    if i >= count {
                        break;
                    }
                }
                #[unroll]
                for k in 0..comptime!(STEP - 1) {
                    list[layers as usize + k] = comptime!(size as u32);
                }
                let steps = (layers + comptime!(STEP as u32 - 1)) / comptime!(STEP as u32);
                if steps > 0 {
                    let (column, row) = block_origin(index, block);
                    let first_column = tile_column + column;
                    let first_row = tile_row + row;
                    let in_tile = (row * comptime!(TILE as u32) + column) as usize;
                    let x = left + f32::cast_from(column);
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
                    let mut checkpoints = Sequence::<Array<f32>>::new();
                    #[unroll]
                    for p in 0..pixels {
                        before[p] = kept[at + comptime!(block.in_tile(p))];
                        rho[p] =
                            rho_behind[slot as usize * comptime!(TILE_PIXELS) + in_tile + comptime!(block.in_tile(p))];
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
                        let mut of_pixel = Array::<f32>::new(comptime!(size / STEP));
                        of_pixel[0] = checkpoint(through[p], stopped[p]);
                        checkpoints.push(of_pixel);
                    }

                    // Forwards: what the layers before each step let through, and stop.
                    if steps > 1 {
                        let mut step = 1u32;
                        loop {
                            #[unroll]
                            for k in 0..comptime!(STEP) {
                                let i = list[((step - 1) * comptime!(STEP as u32)) as usize + k];
                                let footprint = Footprint::among(&splats, i as usize);
                                #[unroll]
                                for p in 0..pixels {
                                    let (u, below) =
                                        footprint.along_column(x + comptime!(block.pixel(p)[0] as f32), top);
                                    let v =
                                        (below + (own_row + comptime!(block.pixel(p)[1] as f32))) * footprint.inverse_v;
                                    let alpha = footprint.alpha(u, v, frame.alpha_min, limits.alpha_max);
                                    let (_, next, stops) =
                                        layer(alpha, through[p], stopped[p], before[p], limits.transmittance_min);
                                    stopped[p] = stops;
                                    through[p] = next;
                                }
                            }
                            #[unroll]
                            for p in 0..pixels {
                                checkpoints.index_mut(p)[step as usize] = checkpoint(through[p], stopped[p]);
                            }
                            step += 1;
                            if step >= steps {
                                break;
                            }
                        }
                    }

                    // Backwards.
                    let mut step = steps;
                    loop {
                        step -= 1;
                        let start = (step * comptime!(STEP as u32)) as usize;
                        let mut alphas = Array::<f32>::new(comptime!(STEP * pixels));
                        let mut weights = Array::<f32>::new(comptime!(STEP * pixels));
                        #[unroll]
                        for p in 0..pixels {
                            let (open, stops) = restore(checkpoints[p][step as usize]);
                            through[p] = open;
                            stopped[p] = stops;
                        }
                        #[unroll]
                        for k in 0..comptime!(STEP) {
                            let i = list[start + k];
                            let footprint = Footprint::among(&splats, i as usize);
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
                            let i = list[start + k] as usize;
                            let footprint = Footprint::among(&splats, i);
                            let slope = footprint.inverse_v * footprint.shear;
                            let mut colour_here = Array::<f32>::new(channels);
                            let mut sum = Array::<f32>::new(columns);
                            #[unroll]
                            for channel in 0..channels {
                                colour_here[channel] = splats[comptime!(FOOTPRINT + channel)][i];
                            }
                            #[unroll]
                            for column in 0..columns {
                                sum[column] = own[column][i];
                            }
                            #[unroll]
                            for across in 0..comptime!(block.across) {
                                let (u, below) = footprint.along_column(x + comptime!(across as f32), top);
                                // Sums of `h, h v, h v²` down the column, where `u` is the same.
                                let mut h_sum = 0.0f32;
                                let mut hv_sum = 0.0f32;
                                let mut hvv_sum = 0.0f32;
                                #[unroll]
                                for line in 0..comptime!(block.down) {
                                    let p = comptime!(across * block.down + line);
                                    let alpha = alphas[comptime!(k * pixels + p)];
                                    let weight = weights[comptime!(k * pixels + p)];
                                    let mut along = grad_alpha[p];
                                    #[unroll]
                                    for channel in 0..channels {
                                        along += gradients[comptime!(p * channels) + channel] * colour_here[channel];
                                        sum[comptime!(MOMENTS) + channel] +=
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
                                        sum[comptime!(MOMENTS + channels)] +=
                                            (h * u * footprint.inverse_u - hv * slope).abs();
                                        sum[comptime!(MOMENTS + channels + 1)] += (hv * footprint.inverse_v).abs();
                                    }
                                }
                                sum[0] += h_sum;
                                sum[1] += h_sum * u;
                                sum[2] += hv_sum;
                                sum[3] += h_sum * u * u;
                                sum[4] += hv_sum * u;
                                sum[5] += hvv_sum;
                            }
                            #[unroll]
                            for column in 0..columns {
                                own.index_mut(column)[i] = sum[column];
                            }
                        }
                        if step == 0 {
                            break;
                        }
                    }
                }
                index += 1;
                if index >= comptime!(block.of_tile() as u32) {
                    break;
                }
            }

            let mut i = 0u32;
            loop {
                let hit = hit_of_place[(first + place + i) as usize] as usize;
                let mut cell = hit * columns;
                if comptime!(add) {
                    cell = gaussian_of_hit[hit] as usize * columns;
                }
                #[unroll]
                for column in 0..columns {
                    let sum = own[column][i as usize];
                    if comptime!(add) {
                        if sum != 0.0 {
                            A::add(&sums[cell + column], sum);
                        }
                    } else {
                        rows[cell + column] = sum;
                    }
                }
                i += 1;
                if i >= count {
                    break;
                }
            }
        }
    }
}
