//! The kernel of `blend`, forwards, for three channels on a driver in software: a unit per tile, for the reasons that `buckets.rs`
//! gives for a unit per bucket. A unit copies a bucket's Gaussians, then goes through the tile block by block, passing only
//! those that reach the block, four pixels side by side (`quads.rs`). What it keeps is what `forward.rs` keeps.
//!
//! The eight units of a vector wait for each other, so units take the tiles by the lengths of their lists, the longest first.

use cubecl::prelude::*;

use super::buckets::{SQUARE, copy_gaussians, list_of_block, room_for_gaussians};
use super::layer::{FOOTPRINT, Footprint, Limits, Shape, block_origin, first_slot};
use super::quads::{Columns, QUAD, Quad, Quads, ROW_QUADS, TILE_QUADS, ascending, gather, quads_of, scatter};
use crate::tile::TILE;
use crate::tile::forward::Frame;

/// Layers between two tests for the end of a list.
const STEP: usize = 2;

/// Bits of a length by which tiles are sorted: four below its highest one, and where that is.
pub(super) const LENGTH_BITS: u32 = 8;

/// For each tile a key that grows as its list becomes shorter, and the tile itself.
#[cube(launch_unchecked)]
pub(super) fn blend_tile_lengths_kernel(tile_start: &[u32], keys: &mut [u32], order: &mut [u32], tiles: u32) {
    let tile = ABSOLUTE_POS;
    if tile < tiles as usize {
        let length = tile_start[tile + 1] - tile_start[tile];
        // The bits of a float: from one on, sixteen classes for each power of two.
        let class = (u32::reinterpret(f32::cast_from(length + 1)) >> 19) - comptime!(127u32 << 4);
        let last = comptime!((1u32 << LENGTH_BITS) - 1);
        keys[tile] = last - min(class, last);
        order[tile] = tile as u32;
    }
}

/// As [`super::forward::blend_forward_kernel`], of kept numbers and transmittances in quads. `order` is what
/// [`blend_tile_lengths_kernel`] left, sorted.
#[cube(launch_unchecked)]
pub(super) fn blend_forward_quads_kernel(
    projected: &[f32],
    features: &[f32],
    background: &[f32],
    tile_start: &[u32],
    hit_of_place: &[u32],
    gaussian_of_hit: &[u32],
    order: &[u32],
    planes: &mut [f32],
    kept: &mut [Quad],
    behind: &mut [Quad],
    passed: &mut [u32],
    frame: Frame,
    limits: Limits,
    #[comptime] shape: Shape,
    #[comptime] keep: bool,
) {
    let channels = comptime!(shape.channels());
    let size = comptime!(shape.bucket);
    let quads = comptime!(SQUARE.pixels() / QUAD);

    if ABSOLUTE_POS < (frame.tiles_x * frame.tiles_y) as usize {
        let tile = order[ABSOLUTE_POS];
        let column = tile % frame.tiles_x * comptime!(TILE as u32);
        let row = tile / frame.tiles_x * comptime!(TILE as u32);
        let left = f32::cast_from(column) + 0.5;
        let top = f32::cast_from(row) + 0.5;
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        let slot = first_slot(first, tile, shape);

        // Block by block, and row by row in each.
        let mut transmittance = quads_of(1.0f32, TILE_QUADS);
        for i in 0..comptime!(TILE_QUADS as u32) {
            let (x, y) = block_origin(i / comptime!(quads as u32), SQUARE);
            let inside = row + y + i % comptime!(quads as u32) < frame.height;
            #[unroll]
            for k in 0..QUAD {
                let inside = inside && column + x + comptime!(k as u32) < frame.width;
                transmittance.index_mut(k)[i as usize] = select(inside, 1.0f32, -1.0f32);
            }
        }
        let mut sums = Sequence::<Sequence<Array<f32>>>::new();
        #[unroll]
        for _ in 0..channels {
            sums.push(quads_of(0.0f32, TILE_QUADS));
        }
        let mut splats = room_for_gaussians(shape);
        let mut list = Array::<u32>::new(comptime!(size + STEP));
        let mut reached = Array::<u32>::new(size);

        let mut place = 0u32;
        // Loops with their tests at their ends: this driver's take a round more otherwise.
        loop {
            let count = min(places - place, comptime!(size as u32));
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
            for i in 0..count {
                let footprint = Footprint::among(&splats, i as usize);
                reached[i as usize] = footprint.blocks_met(left, top, frame.alpha_min, SQUARE);
            }
            let mut most = 0.0f32;
            let mut index = 0u32;
            loop {
                let layers = list_of_block(&reached, &mut list, index, count, shape, STEP);
                let (column, row) = block_origin(index, SQUARE);
                let x = ascending(left + f32::cast_from(column));
                let own_row = f32::cast_from(row);
                let quad = (index * comptime!(quads as u32)) as usize;
                let mut state = Quads::new(quads);
                let mut own = Array::<Quad>::new(comptime!(quads * channels));
                #[unroll]
                for q in 0..quads {
                    state.open(gather(&transmittance, quad + q), frame.alpha_min, q);
                    #[unroll]
                    for channel in 0..channels {
                        own[comptime!(q * channels + channel)] = Quad::new(0.0);
                    }
                }
                let mut passed = 0u32;
                loop {
                    #[unroll]
                    for k in 0..STEP {
                        let i = list[passed as usize + k] as usize;
                        let at = Columns::of(&Footprint::among(&splats, i), x, top);
                        #[unroll]
                        for q in 0..quads {
                            let v = at.v(own_row + comptime!(q as f32));
                            let (_, weight) = state.pass(&at, v, limits, shape, q);
                            #[unroll]
                            for channel in 0..channels {
                                own[comptime!(q * channels + channel)] +=
                                    weight * Quad::new(splats[comptime!(FOOTPRINT + channel)][i]);
                            }
                        }
                    }
                    passed += comptime!(STEP as u32);
                    if passed >= layers {
                        break;
                    }
                }

                let in_tile = (row * comptime!(ROW_QUADS as u32) + column / comptime!(QUAD as u32)) as usize;
                let at =
                    (slot + place / comptime!(size as u32)) as usize * comptime!(shape.kept() * TILE_QUADS) + in_tile;
                #[unroll]
                for q in 0..quads {
                    let before = state.before[q];
                    let left = state.behind(q);
                    if comptime!(keep) {
                        let at = at + comptime!(q * ROW_QUADS);
                        kept[at] = before;
                        kept[at + TILE_QUADS] = state.through[q];
                        #[unroll]
                        for channel in 0..channels {
                            kept[at + comptime!((channel + 2) * TILE_QUADS)] = own[comptime!(q * channels + channel)];
                        }
                    }
                    #[unroll]
                    for channel in 0..channels {
                        let sum = before.abs() * own[comptime!(q * channels + channel)];
                        let sum = gather(&sums[channel], quad + q) + sum;
                        scatter(sums.index_mut(channel), quad + q, sum);
                    }
                    scatter(&mut transmittance, quad + q, left);
                    #[unroll]
                    for k in 0..QUAD {
                        most = max(most, left.extract(k));
                    }
                }
                index += 1;
                if index >= comptime!(SQUARE.of_tile() as u32) {
                    break;
                }
            }
            place += count;
            // A transmittance that came to zero without being finished shows nothing any more.
            if most <= 0.0 || place >= places {
                break;
            }
        }

        if comptime!(keep) {
            passed[tile as usize] = (place + comptime!(size as u32 - 1)) / comptime!(size as u32);
        }
        let plane = (frame.width * frame.height) as usize;
        let mut quad = 0u32;
        loop {
            let (x, y) = block_origin(quad / comptime!(quads as u32), SQUARE);
            let y = y + quad % comptime!(quads as u32);
            let from = quad as usize;
            if comptime!(keep) {
                let in_tile = (y * comptime!(ROW_QUADS as u32) + x / comptime!(QUAD as u32)) as usize;
                behind[tile as usize * TILE_QUADS + in_tile] = gather(&transmittance, from).abs();
            }
            #[unroll]
            for k in 0..QUAD {
                let x = column + x + comptime!(k as u32);
                if x < frame.width && row + y < frame.height {
                    let pixel = ((row + y) * frame.width + x) as usize;
                    let left = transmittance[k][from].abs();
                    #[unroll]
                    for channel in 0..comptime!(shape.features) {
                        planes[channel * plane + pixel] = sums[channel][k][from] + left * background[channel];
                    }
                    planes[comptime!(shape.features) * plane + pixel] = 1.0 - left;
                    if comptime!(shape.depth) {
                        planes[comptime!(shape.features + 1) * plane + pixel] = sums[shape.features][k][from];
                    }
                }
            }
            quad += 1;
            if quad >= comptime!(TILE_QUADS as u32) {
                break;
            }
        }
    }
}
