//! The layers of a bucket, backwards, for three channels on a driver in software: a unit per bucket.
//!
//! Such a driver runs eight units as one vector, but reads and writes memory for each of them one after the other, much
//! slower than it computes; private arrays are not much slower than registers. So units share nothing: each copies its
//! bucket's Gaussians and keeps their sums to itself, and goes through the tile block by block, passing only those that reach
//! the block, four pixels side by side (`quads.rs`).
//!
//! The eight units of a vector wait for each other, so they should have as much to do: units take the buckets by their
//! length, the longest first. (On `fox_small` that, and leaving out the blocks within an ellipse's bounding box that the
//! ellipse does not meet, makes 1.6 million passes of a vector over a pixel into 1.0 million; none idle would be 0.6.)

use cubecl::prelude::*;

use super::backward::{MOMENTS, row_len, tile_of_slot};
use super::layer::{Block, FOOTPRINT, Footprint, Limits, Shape, block_origin, colour, first_slot};
use super::quads::{Columns, QUAD, Quad, Quads, ROW_QUADS, TILE_QUADS, across, ascending};
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

/// Places that are worked on at once. Their alphas and weights lie in registers.
const STEP: usize = 4;

/// The pixels that a unit goes through at once.
pub(super) const SQUARE: Block = Block { across: QUAD, down: 4 };

/// An array for each number of a bucket's Gaussians, as [`Footprint::among`] takes them, and for each of their channels, of one
/// more than there are places. The last shows nowhere.
#[cube]
pub(super) fn room_for_gaussians(#[comptime] shape: Shape) -> Sequence<Array<f32>> {
    // A driver's compiler takes time with the square of the numbers that it sets to zero at once, so a loop follows each
    // array.
    let mut splats = Sequence::<Array<f32>>::new();
    #[unroll]
    for _ in 0..comptime!(FOOTPRINT + shape.channels()) {
        let mut values = Array::<f32>::new(comptime!(shape.bucket + 1));
        for i in 0..comptime!(shape.bucket as u32 + 1) {
            values[i as usize] = 0.0f32;
        }
        splats.push(values);
    }
    splats
}

/// Copies `count` Gaussians from place `first` on.
#[cube]
pub(super) fn copy_gaussians(
    splats: &mut Sequence<Array<f32>>,
    projected: &[f32],
    features: &[f32],
    hit_of_place: &[u32],
    gaussian_of_hit: &[u32],
    first: u32,
    count: u32,
    #[comptime] shape: Shape,
) {
    for i in 0..count {
        let gaussian = gaussian_of_hit[hit_of_place[(first + i) as usize] as usize] as usize;
        #[unroll]
        for number in 0..comptime!(FOOTPRINT + shape.channels()) {
            splats.index_mut(number)[i as usize] = if comptime!(number < FOOTPRINT) {
                Footprint::number(projected, gaussian, number)
            } else {
                colour(projected, features, gaussian, comptime!(number - FOOTPRINT), shape)
            };
        }
    }
}

/// The places of a bucket that reach block `index`, in order, then `step` times the place that shows nowhere; how many reach
/// it.
#[cube]
pub(super) fn list_of_block(
    reached: &Array<u32>,
    list: &mut Array<u32>,
    index: u32,
    count: u32,
    #[comptime] shape: Shape,
    #[comptime] step: usize,
) -> u32 {
    let mut layers = 0u32;
    for i in 0..count {
        list[layers as usize] = i;
        layers += reached[i as usize] >> index & 1;
    }
    #[unroll]
    for k in 0..step {
        list[layers as usize + k] = comptime!(shape.bucket as u32);
    }
    layers
}

/// Rows of the hits of each bucket.
///
/// `grad` is what [`super::quads_behind`] left of the planes' gradient, tile by tile, and `order` what [`blend_lengths_kernel`]
/// left, sorted. `rows` is `[H, row]` and every hit's row is written, or, with `add`, one row per Gaussian that is added to in
/// `sums`.
#[cube(launch_unchecked)]
pub(super) fn blend_buckets_kernel<A: FloatCell>(
    projected: &[f32],
    features: &[f32],
    grad: &[Quad],
    tile_start: &[u32],
    hit_of_place: &[u32],
    gaussian_of_hit: &[u32],
    kept: &[Quad],
    passed: &[u32],
    rho_behind: &[Quad],
    order: &[u32],
    rows: &mut [f32],
    sums: &[A],
    frame: Frame,
    limits: Limits,
    slots: u32,
    #[comptime] shape: Shape,
    #[comptime] absolute: bool,
    #[comptime] add: bool,
) {
    let channels = comptime!(shape.channels());
    let columns = comptime!(row_len(shape, absolute));
    let size = comptime!(shape.bucket);
    let quads = comptime!(SQUARE.pixels() / QUAD);
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

            let mut splats = room_for_gaussians(shape);
            copy_gaussians(
                &mut splats,
                projected,
                features,
                hit_of_place,
                gaussian_of_hit,
                first + place,
                count,
                shape,
            );
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
                let blocks = footprint.blocks_met(left, top, frame.alpha_min, SQUARE);
                reached[i as usize] = select(skipped, 0u32, blocks);
            }
            let mut checkpoints = Sequence::<Array<f32>>::new();
            #[unroll]
            for _ in 0..comptime!(SQUARE.pixels()) {
                let mut values = Array::<f32>::new(comptime!(size / STEP));
                for i in 0..comptime!((size / STEP) as u32) {
                    values[i as usize] = 0.0f32;
                }
                checkpoints.push(values);
            }
            let mut list = Array::<u32>::new(comptime!(size + STEP));

            // Loops with their tests at their ends: this driver's take a round more otherwise.
            let mut index = 0u32;
            loop {
                let layers = list_of_block(&reached, &mut list, index, count, shape, STEP);
                let steps = max((layers + comptime!(STEP as u32 - 1)) / comptime!(STEP as u32), 1u32);

                let (column, row) = block_origin(index, SQUARE);
                let x = ascending(left + f32::cast_from(column));
                let own_row = f32::cast_from(row);
                let in_tile = (row * comptime!(ROW_QUADS as u32) + column / comptime!(QUAD as u32)) as usize;
                let mut state = Quads::new(quads);
                let mut rho = Array::<Quad>::new(quads);
                let mut grad_alpha = Array::<Quad>::new(quads);
                let mut gradients = Array::<Quad>::new(comptime!(quads * channels));
                #[unroll]
                for q in 0..quads {
                    let at = in_tile + comptime!(q * ROW_QUADS);
                    state.open(kept[slot as usize * comptime!(shape.kept() * TILE_QUADS) + at], frame.alpha_min, q);
                    rho[q] = rho_behind[slot as usize * TILE_QUADS + at];
                    let at = tile as usize * comptime!(shape.gradients() * TILE_QUADS) + at;
                    #[unroll]
                    for channel in 0..channels {
                        gradients[comptime!(q * channels + channel)] = grad[at + comptime!(channel * TILE_QUADS)];
                    }
                    grad_alpha[q] = Quad::new(0.0);
                    if comptime!(shape.grad_alpha) {
                        grad_alpha[q] = grad[at + comptime!(channels * TILE_QUADS)];
                    }
                }

                // Forwards: what the layers before each step let through, and stop.
                let mut step = 0u32;
                loop {
                    store_checkpoints(&mut checkpoints, &state, step as usize, quads);
                    #[unroll]
                    for k in 0..STEP {
                        let i = list[(step * comptime!(STEP as u32)) as usize + k];
                        let at = Columns::of(&Footprint::among(&splats, i as usize), x, top);
                        #[unroll]
                        for q in 0..quads {
                            state.pass(&at, at.v(own_row + comptime!(q as f32)), limits, shape, q);
                        }
                    }
                    step += 1;
                    if step + 1 >= steps {
                        break;
                    }
                }
                store_checkpoints(&mut checkpoints, &state, step as usize, quads);

                step = steps;
                loop {
                    step -= 1;
                    let mut alphas = Array::<Quad>::new(comptime!(STEP * quads));
                    let mut weights = Array::<Quad>::new(comptime!(STEP * quads));
                    let mut places = Sequence::<usize>::new();
                    let mut us = Sequence::<Quad>::new();
                    let mut belows = Sequence::<Quad>::new();
                    #[unroll]
                    for q in 0..quads {
                        let mut from = Quad::new(0.0);
                        #[unroll]
                        for k in 0..QUAD {
                            from.insert(k, checkpoints[comptime!(q * QUAD + k)][step as usize]);
                        }
                        state.restore(from, frame.alpha_min, q);
                    }
                    #[unroll]
                    for k in 0..STEP {
                        let i = list[(step * comptime!(STEP as u32)) as usize + k] as usize;
                        let at = Columns::of(&Footprint::among(&splats, i), x, top);
                        #[unroll]
                        for q in 0..quads {
                            let (alpha, weight) =
                                state.pass(&at, at.v(own_row + comptime!(q as f32)), limits, shape, q);
                            alphas[comptime!(k * quads + q)] = alpha;
                            weights[comptime!(k * quads + q)] = weight * state.before[q];
                        }
                        places.push(i);
                        us.push(at.u);
                        belows.push(at.below);
                    }
                    #[unroll]
                    for from_end in 0..STEP {
                        let k = comptime!(STEP - 1 - from_end);
                        let i = places[k];
                        let (u, below) = (us[k], belows[k]);
                        // Sums of `h`, `h v`, `h v²`, and weight times gradient, down the columns.
                        let mut h_sum = Quad::new(0.0);
                        let mut hv_sum = Quad::new(0.0);
                        let mut hvv_sum = Quad::new(0.0);
                        let mut absolute_x = Quad::new(0.0);
                        let mut absolute_y = Quad::new(0.0);
                        let mut colours = Array::<Quad>::new(channels);
                        #[unroll]
                        for channel in 0..channels {
                            colours[channel] = Quad::new(0.0);
                        }
                        let inverse_u = Quad::new(splats[2][i]);
                        let inverse_v = splats[3][i];
                        let slope = Quad::new(inverse_v * splats[4][i]);
                        #[unroll]
                        for q in 0..quads {
                            let alpha = alphas[comptime!(k * quads + q)];
                            let weight = weights[comptime!(k * quads + q)];
                            let mut along = grad_alpha[q];
                            #[unroll]
                            for channel in 0..channels {
                                let gradient = gradients[comptime!(q * channels + channel)];
                                along += gradient * Quad::new(splats[comptime!(FOOTPRINT + channel)][i]);
                                colours[channel] += weight * gradient;
                            }
                            let ahead = along - rho[q];
                            rho[q] += alpha * ahead;
                            let free = alpha.less_than(&Quad::new(limits.alpha_max));
                            let h = select_many(free, weight * ahead, Quad::new(0.0));
                            let v = Columns::v_of(below, inverse_v, own_row + comptime!(q as f32));
                            let hv = h * v;
                            h_sum += h;
                            hv_sum += hv;
                            hvv_sum += hv * v;
                            if comptime!(absolute) {
                                absolute_x += (h * u * inverse_u - hv * slope).abs();
                                absolute_y += (hv * Quad::new(inverse_v)).abs();
                            }
                        }
                        let unit = Columns::unit();
                        let hu_sum = h_sum * u;
                        own.index_mut(0usize)[i] += across(h_sum);
                        own.index_mut(1usize)[i] += across(hu_sum) * unit;
                        own.index_mut(2usize)[i] += across(hv_sum) * unit;
                        own.index_mut(3usize)[i] += across(hu_sum * u) * (unit * unit);
                        own.index_mut(4usize)[i] += across(hv_sum * u) * (unit * unit);
                        own.index_mut(5usize)[i] += across(hvv_sum) * (unit * unit);
                        #[unroll]
                        for channel in 0..channels {
                            own.index_mut(comptime!(MOMENTS + channel))[i] += across(colours[channel]);
                        }
                        if comptime!(absolute) {
                            own.index_mut(comptime!(MOMENTS + channels))[i] += across(absolute_x) * unit;
                            own.index_mut(comptime!(MOMENTS + channels + 1))[i] += across(absolute_y) * unit;
                        }
                    }
                    if step == 0 {
                        break;
                    }
                }
                index += 1;
                if index >= comptime!(SQUARE.of_tile() as u32) {
                    break;
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

/// Notes where all pixels are before step `step`, an array each.
#[cube]
fn store_checkpoints(checkpoints: &mut Sequence<Array<f32>>, state: &Quads, step: usize, #[comptime] quads: usize) {
    #[unroll]
    for q in 0..quads {
        let here = state.checkpoint(q);
        #[unroll]
        for k in 0..QUAD {
            checkpoints.index_mut(comptime!(q * QUAD + k))[step] = here.extract(k);
        }
    }
}
