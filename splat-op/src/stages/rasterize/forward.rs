//! Forward kernel of `rasterize`: a cube per tile, a unit per pixel.
//!
//! The places of a tile are passed in segments of four buckets. Two units load each Gaussian of a segment and find the
//! blocks of pixels that may see it. These are bits of a word per bucket and block. The units of a block then go
//! through the bits of their word alone, so a block evaluates no Gaussian that passes by it, in the order of the places.

use cubecl::prelude::*;

use super::blocks::{BLOCK_PIXELS, BLOCKS, HALF_BLOCKS, pixel_of};
use super::layer::{
    BUCKET, BUCKETS, Four, KernelShape, RasterFrame, SEGMENT, SplatInputs, TilePixel, add_compensated, first_slot,
    layer, lost_after_bucket, tile_origin, transmittance_after_bucket,
};
use super::splat::{Splat, colour, colours_of};
use super::trace::{TileRun, WORDS};
use crate::intersect::{TILE_PIXELS, TILE_SIZE};

/// Writes the planes `[C, H, W]`, and from `alpha_start` and `depth_start` on those of alpha and depth. If a trace is kept, it also writes
/// - the kept values `[slot][value][unit]`,
/// - words `[slot][bucket][block]` of the places that some pixel of the block needs,
/// - the tile of each slot,
/// - the transmittance behind all layers `[tile][unit]`,
/// - the number of segments passed in each tile.
///
/// The transmittance of a finished pixel is negated. A pixel outside the picture is finished from the start.
#[cube(launch_unchecked)]
pub(super) fn rasterize_forward_kernel<S: Splat>(
    inputs: SplatInputs,
    background: &[f32],
    planes: &mut [f32],
    kept: &mut [f32],
    kept_words: &mut [u32],
    tile_of_slot: &mut [u32],
    final_transmittance: &mut [f32],
    segment_count: &mut [u32],
    frame: RasterFrame,
    run: TileRun,
    alpha_start: u32,
    depth_start: u32,
    #[comptime] shape: KernelShape,
    #[comptime] keep: bool,
) {
    let channels = comptime!(shape.channels());
    let few = comptime!(shape.few());
    let held = comptime!(shape.held());
    let tile = run.first_tile + CUBE_POS as u32;
    let mut splats = Shared::<[Four]>::new_slice(comptime!(SEGMENT * S::VECTORS));
    let mut colours = Shared::<[Four]>::new_slice(comptime!(if few { SEGMENT } else { 1 }));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(if few { 1 } else { SEGMENT }));
    // Places that the block may see, and places that some pixel of the block needs.
    let met = Shared::<[Atomic<u32>]>::new_slice(comptime!(WORDS));
    let needed = Shared::<[Atomic<u32>]>::new_slice(comptime!(WORDS));
    let anybody = Shared::<[Atomic<u32>]>::new_slice(1usize);
    // What rounding took from each pixel's sums. A pixel needs it once per segment: it takes no register in between.
    let mut lost_sums = Shared::<[f32]>::new_slice(comptime!(if few { channels * TILE_PIXELS } else { 1 }));

    if tile < run.end_tile {
        let unit = UNIT_POS;
        let block = unit / comptime!(BLOCK_PIXELS as u32);
        let pixel = TilePixel::of(tile_origin(tile, &frame), pixel_of(unit), &inputs, &frame);
        let left = f32::cast_from(tile % frame.tiles_x * comptime!(TILE_SIZE as u32)) + 0.5;
        let first = inputs.lists.start(tile);
        let end = inputs.lists.start(tile + 1);
        let places = end - first;
        let slot = first_slot(first, tile) - run.first_slot;
        if comptime!(keep) {
            let slots = first_slot(end, tile + 1) - run.first_slot - slot;
            let mut i = unit;
            while i < slots {
                tile_of_slot[(slot + i) as usize] = tile;
                i += comptime!(TILE_PIXELS as u32);
            }
        }

        let mut transmittance = select(pixel.inside, 1.0f32, -1.0f32);
        let mut lost = 0.0f32;
        let mut sums = Array::<f32>::new(channels);
        let mut own = Array::<f32>::new(channels);
        #[unroll(held)]
        for channel in 0..channels {
            sums[channel] = 0.0f32;
            if comptime!(few) {
                lost_sums[channel * comptime!(TILE_PIXELS) + unit as usize] = 0.0f32;
            }
        }
        if unit < comptime!(WORDS as u32) {
            met[unit as usize].store(0u32);
            needed[unit as usize].store(0u32);
        }
        sync_cube();

        let mut segment = 0u32;
        let mut running = places > 0;
        while running {
            // Two units load a Gaussian, and each tests a half of the tile.
            let i = unit % comptime!(SEGMENT as u32);
            let half = unit / comptime!(SEGMENT as u32);
            let place = segment * comptime!(SEGMENT as u32) + i;
            if place < places {
                let gaussian = inputs.lists.gaussian(first + place);
                let splat = S::of(&inputs, gaussian as usize, pixel.top, &frame);
                if half == 0 {
                    S::store(&splat, &mut splats, i as usize);
                    if comptime!(!few) {
                        gaussians[i as usize] = gaussian;
                    }
                } else if comptime!(few) {
                    colours[i as usize] = colours_of::<S>(&inputs, gaussian as usize, shape);
                }
                let bits = S::blocks_met(&splat, left, half, &frame);
                let word =
                    i / comptime!(BUCKET as u32) * comptime!(BLOCKS as u32) + half * comptime!(HALF_BLOCKS as u32);
                let bit = 1u32 << (i % comptime!(BUCKET as u32));
                #[unroll]
                for k in 0..comptime!(HALF_BLOCKS) {
                    if (bits & comptime!(1u32 << k)) != 0 {
                        met[word as usize + k].fetch_or(bit);
                    }
                }
            }
            if unit == 0 {
                anybody[0].store(0u32);
            }
            sync_cube();

            let at = (slot + segment) as usize * comptime!(shape.kept() * TILE_PIXELS) + unit as usize;
            if comptime!(keep) {
                kept[at] = transmittance;
            }
            #[unroll(held)]
            for channel in 0..channels {
                own[channel] = 0.0f32;
            }
            for bucket in 0..comptime!(BUCKETS as u32) {
                let at_word = (bucket * comptime!(BLOCKS as u32) + block) as usize;
                let before = transmittance;
                let mut word = 0u32;
                if before >= 0.0 {
                    word = met[at_word].load();
                }
                let mut through = 1.0f32;
                let mut stopped = 0.0f32;
                let mut shown = 0u32;
                while word != 0 {
                    let i = word.trailing_zeros();
                    word &= word - 1;
                    let place = (bucket * comptime!(BUCKET as u32) + i) as usize;
                    let (value, depth) = S::seen(&S::load(&splats, place, &inputs), &pixel, &frame);
                    let (alpha, next, stops) = layer(value, through, stopped, before, frame.transmittance_min);
                    let weight = alpha * (before * through);
                    through = next;
                    stopped = stops;
                    // A layer that finishes a pixel is needed too.
                    shown |= select(value > 0.0, 1u32 << i, 0u32);
                    if through < 0.0 {
                        word = 0u32;
                    }
                    // A feature may be infinite or undefined, and zero times it would be undefined.
                    if alpha > 0.0 {
                        if comptime!(few) {
                            let all = colours[place];
                            #[unroll]
                            for channel in 0..channels {
                                let along_ray = comptime!(S::ALONG_RAYS && channel == shape.features);
                                own[channel] += weight * if along_ray { depth } else { all.extract(channel) };
                            }
                        } else {
                            let gaussian = gaussians[place] as usize;
                            #[unroll(held)]
                            for channel in 0..channels {
                                own[channel] += weight * colour::<S>(&inputs, gaussian, channel, depth, shape);
                            }
                        }
                    }
                }
                // A pixel that finishes in this bucket becomes negative here; one that finished earlier stays negative.
                transmittance = transmittance_after_bucket(before, through, stopped);
                lost = lost_after_bucket(lost, before, transmittance, through, stopped);
                if comptime!(keep) && shown != 0 {
                    needed[at_word].fetch_or(shown);
                }
            }
            #[unroll(held)]
            for channel in 0..channels {
                if comptime!(few) {
                    let place = channel * comptime!(TILE_PIXELS) + unit as usize;
                    let (sum, lost_sum) = add_compensated(sums[channel], lost_sums[place], own[channel]);
                    sums[channel] = sum;
                    lost_sums[place] = lost_sum;
                    if comptime!(keep) {
                        kept[at + (channel + 1) * comptime!(TILE_PIXELS)] = own[channel];
                    }
                } else {
                    sums[channel] += own[channel];
                }
            }
            if transmittance >= 0.0 {
                anybody[0].fetch_or(1u32);
                let (sum, lost_sum) = add_compensated(transmittance, lost, 0.0f32);
                transmittance = sum;
                lost = lost_sum;
            }
            sync_cube();

            if unit < comptime!(WORDS as u32) {
                if comptime!(keep) {
                    let places = needed[unit as usize].load();
                    kept_words[((slot + segment) * comptime!(WORDS as u32) + unit) as usize] = places;
                }
                met[unit as usize].store(0u32);
                needed[unit as usize].store(0u32);
            }
            segment += 1;
            let others = workgroup_uniform_load_atomic(&anybody[0]);
            // The next segment resets the cell, and only WGSL has a barrier behind this load.
            sync_cube();
            running = others != 0 && segment * comptime!(SEGMENT as u32) < places;
        }

        if comptime!(keep) {
            final_transmittance[tile as usize * comptime!(TILE_PIXELS) + unit as usize] = transmittance.abs();
            if unit == 0 {
                segment_count[tile as usize] = segment;
            }
        }
        if pixel.inside {
            let plane = (frame.width * frame.height) as usize;
            let left = transmittance.abs();
            #[unroll(held)]
            for channel in 0..comptime!(shape.features) {
                planes[channel * plane + pixel.index] = sums[channel] + left * background[channel];
            }
            planes[alpha_start as usize + pixel.index] = 1.0 - left;
            if comptime!(shape.depth) {
                planes[depth_start as usize + pixel.index] = sums[comptime!(shape.features)];
            }
        }
    }
}
