//! The layers of a bucket, backwards, for few channels on a driver in software: a unit per bucket.
//!
//! Such a driver runs eight units as one vector, but reads and writes memory for each of them one after the other, ten times
//! slower than it computes; private arrays are not much slower than registers. So units share nothing: each copies its
//! bucket's Gaussians and keeps their sums to itself, and goes through the tile block by block, passing only those that reach
//! the block.
//!
//! The eight units of a vector wait for each other, so they should have as much to do: units take the buckets by their
//! length, the longest first. (On `fox_small` that, and leaving out the blocks within an ellipse's bounding box that the
//! ellipse does not meet, makes 1.6 million passes of a vector over a pixel into 1.0 million; none idle would be 0.6.)

use cubecl::prelude::*;

use super::backward::{row_len, tile_of_slot};
use super::layer::{Block, FOOTPRINT, Footprint, Limits, Shape, block_origin, colour, first_slot};
use super::pixels::{Pixels, STEP};
use crate::gpu::atomic::FloatCell;
use crate::tile::TILE;
use crate::tile::forward::Frame;

/// Bits of a length by which buckets are sorted.
pub(super) const LENGTH_BITS: u32 = 4;

/// For each slot a key that grows as its bucket becomes shorter, and the slot itself.
#[cube(launch_unchecked)]
pub(super) fn blend_lengths_kernel(
    tile_start: &[u32],
    keys: &mut [u32],
    order: &mut [u32],
    tiles: u32,
    slots: u32,
    #[comptime] shape: Shape,
) {
    let size = comptime!(shape.bucket as u32);
    let longest = comptime!((1u32 << LENGTH_BITS) - 1);
    let slot = ABSOLUTE_POS as u32;
    if slot < slots {
        let tile = tile_of_slot(tile_start, tiles, slot, shape);
        let first = tile_start[tile as usize];
        let end = tile_start[tile as usize + 1];
        let start = min(first + (slot - first_slot(first, tile, shape)) * size, end);
        let length = min(end - start, size);
        keys[slot as usize] = longest - (length * longest + comptime!(shape.bucket as u32 - 1)) / size;
        order[slot as usize] = slot;
    }
}

/// Rows of the hits of each bucket.
///
/// `order` is what [`blend_lengths_kernel`] left, sorted. `rows` is `[H, row]` and every hit's row is written, or, with `add`, one row
/// per Gaussian that is added to in `sums`.
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
    order: &[u32],
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
    if ABSOLUTE_POS < slots as usize {
        let slot = order[ABSOLUTE_POS];
        let tile = tile_of_slot(tile_start, frame.tiles_x * frame.tiles_y, slot, shape);
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        let bucket = slot - first_slot(first, tile, shape);
        let place = bucket * comptime!(size as u32);
        if place < places {
            let count = min(places - place, comptime!(size as u32));
            let left = f32::cast_from(tile % frame.tiles_x * comptime!(TILE as u32)) + 0.5;
            let top = f32::cast_from(tile / frame.tiles_x * comptime!(TILE as u32)) + 0.5;

            // An array for each number, of one more than there are places: the last shows nowhere. A driver's compiler takes
            // time with the square of the numbers that it sets to zero at once, so a loop follows each array.
            let mut gaussians = Array::<u32>::new(size);
            for i in 0..count {
                gaussians[i as usize] = gaussian_of_hit[hit_of_place[(first + place + i) as usize] as usize];
            }
            let mut splats = Sequence::<Array<f32>>::new();
            #[unroll]
            for number in 0..numbers {
                let mut values = Array::<f32>::new(comptime!(size + 1));
                values[size] = 0.0f32;
                for i in 0..count {
                    let gaussian = gaussians[i as usize] as usize;
                    values[i as usize] = if comptime!(number < FOOTPRINT) {
                        Footprint::number(projected, gaussian, number)
                    } else {
                        colour(projected, features, gaussian, comptime!(number - FOOTPRINT), shape)
                    };
                }
                splats.push(values);
            }
            let mut own = Sequence::<Array<f32>>::new();
            #[unroll]
            for _ in 0..columns {
                let mut values = Array::<f32>::new(comptime!(size + 1));
                for i in 0..comptime!(size as u32 + 1) {
                    values[i as usize] = 0.0f32;
                }
                own.push(values);
            }
            let mut reached = Array::<u32>::new(size);
            let skipped = bucket >= passed[tile as usize];
            for i in 0..count {
                let footprint = Footprint::among(&splats, i as usize);
                let blocks = footprint.blocks_met(left, top, frame.alpha_min, block);
                reached[i as usize] = select(skipped, 0u32, blocks);
            }

            for index in 0..comptime!(block.of_tile() as u32) {
                let mut list = Array::<u32>::new(comptime!(size + STEP));
                let mut layers = 0u32;
                for i in 0..count {
                    if (reached[i as usize] >> index & 1) != 0 {
                        list[layers as usize] = i;
                        layers += 1;
                    }
                }
                #[unroll]
                for k in 0..comptime!(STEP - 1) {
                    list[layers as usize + k] = comptime!(size as u32);
                }
                let steps = (layers + comptime!(STEP as u32 - 1)) / comptime!(STEP as u32);
                if steps > 0 {
                    let (column, row) = block_origin(index, block);
                    let mut at = Pixels::new(tile, column, row, frame, shape, block);
                    let mut checkpoints = Sequence::<Array<f32>>::new();
                    #[unroll]
                    for p in 0..pixels {
                        at.load(kept, rho_behind, grad, slot, tile, column, row, frame, shape, block, p);
                        checkpoints.push(Array::<f32>::new(comptime!(size / STEP)));
                    }

                    // Forwards: what the layers before each step let through, and stop. Nothing comes after the last.
                    for step in 0..steps {
                        #[unroll]
                        for p in 0..pixels {
                            checkpoints.index_mut(p)[step as usize] = at.checkpoint(p);
                        }
                        if step + 1 < steps {
                            #[unroll]
                            for k in 0..comptime!(STEP) {
                                let i = list[(step * comptime!(STEP as u32)) as usize + k];
                                let footprint = Footprint::among(&splats, i as usize);
                                #[unroll]
                                for p in 0..pixels {
                                    at.pass(footprint, frame.alpha_min, limits, block, p);
                                }
                            }
                        }
                    }

                    for back in 0..steps {
                        let step = (steps - 1 - back) as usize;
                        let mut alphas = Array::<f32>::new(comptime!(STEP * pixels));
                        let mut weights = Array::<f32>::new(comptime!(STEP * pixels));
                        #[unroll]
                        for p in 0..pixels {
                            at.restore(checkpoints[p][step], p);
                        }
                        #[unroll]
                        for k in 0..comptime!(STEP) {
                            let i = list[step * comptime!(STEP) + k];
                            let footprint = Footprint::among(&splats, i as usize);
                            #[unroll]
                            for p in 0..pixels {
                                let (alpha, weight) = at.pass(footprint, frame.alpha_min, limits, block, p);
                                alphas[comptime!(k * pixels + p)] = alpha;
                                weights[comptime!(k * pixels + p)] = weight;
                            }
                        }
                        #[unroll]
                        for from_end in 0..comptime!(STEP) {
                            let k = comptime!(STEP - 1 - from_end);
                            let i = list[step * comptime!(STEP) + k] as usize;
                            let mut colour_here = Array::<f32>::new(channels);
                            let mut row = Array::<f32>::new(columns);
                            #[unroll]
                            for channel in 0..channels {
                                colour_here[channel] = splats[comptime!(FOOTPRINT + channel)][i];
                            }
                            #[unroll]
                            for column in 0..columns {
                                row[column] = own[column][i];
                            }
                            at.add_sums(
                                Footprint::among(&splats, i),
                                &colour_here,
                                &alphas,
                                &weights,
                                &mut row,
                                limits.alpha_max,
                                shape,
                                absolute,
                                block,
                                k,
                            );
                            #[unroll]
                            for column in 0..columns {
                                own.index_mut(column)[i] = row[column];
                            }
                        }
                    }
                }
            }

            for i in 0..count {
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
            }
        }
    }
}
