//! A block of a bucket in the backward pass: first its pixels pass the bucket's places, then the places sum over the pixels.

use cubecl::prelude::*;

use super::MOMENTS;
use super::blocks::{BLOCK_PIXELS, pixel_of};
use super::layer::{BUCKET, BUCKETS, Four, KernelShape, RasterFrame, SplatInputs, TilePixel, layer};
use super::splat::{BlockPairs, Splat, colour};
use super::suffix::plane_of;
use super::trace::WORDS;
use crate::intersect::TILE_PIXELS;

/// Number of units of a cube: of the pixels in a block and of the places in a bucket.
pub(super) const SEGMENT_UNITS: usize = 32;
const _: () = assert!(BLOCK_PIXELS == SEGMENT_UNITS && BUCKET == SEGMENT_UNITS && WORDS == SEGMENT_UNITS);

/// Distance of the rows of a table of places and pixels. Neither direction of reading has bank conflicts.
pub(super) const STRIDE: usize = SEGMENT_UNITS + 1;

/// Shared memory of a cube.
#[derive(CubeType)]
pub(super) struct SegmentMemory {
    pub words: Shared<[u32]>,
    /// `[bucket][unit]`: the transmittances before each bucket.
    pub checkpoints: Shared<[f32]>,
    /// `[unit]`: `ρ` behind the layers still to pass.
    pub rho: Shared<[f32]>,
    /// Of the bucket.
    pub splats: Shared<[Four]>,
    pub gaussians: Shared<[u32]>,
    /// Rows that the sums are written or added to.
    pub targets: Shared<[u32]>,
    /// `[place][pixel]`: alphas at first, then `h`.
    pub alphas: Shared<[f32]>,
    pub weights: Shared<[f32]>,
}

#[cube]
impl SegmentMemory {
    pub fn new<S: Splat>() -> SegmentMemory {
        SegmentMemory {
            words: Shared::<[u32]>::new_slice(comptime!(WORDS)),
            checkpoints: Shared::<[f32]>::new_slice(comptime!(BUCKETS * TILE_PIXELS)),
            rho: Shared::<[f32]>::new_slice(comptime!(TILE_PIXELS)),
            splats: Shared::<[Four]>::new_slice(comptime!(BUCKET * S::VECTORS)),
            gaussians: Shared::<[u32]>::new_slice(comptime!(BUCKET)),
            targets: Shared::<[u32]>::new_slice(comptime!(BUCKET)),
            alphas: Shared::<[f32]>::new_slice(comptime!(BUCKET * STRIDE)),
            weights: Shared::<[f32]>::new_slice(comptime!(BUCKET * STRIDE)),
        }
    }
}

/// Number of places whose channels a unit sums, and of units that have the same places.
pub(super) const SIDE: usize = 8;

/// Number of a unit's sums of channels: every [`SIDE`]-th channel of [`SIDE`] places.
pub(super) const fn sums_len(shape: KernelShape) -> usize {
    shape.channels().next_multiple_of(if shape.held() { SIDE } else { SEGMENT_UNITS })
}

/// Passes the places of a block's word, of a bucket: leaves `h` and the weights of each place and pixel in the tables, and `ρ` in
/// front of the bucket. The units are pixels. `g` is left in the channels' columns of `row`.
#[cube]
pub(super) fn pass_pixels<S: Splat>(
    row: &mut Array<f32>,
    memory: &mut SegmentMemory,
    word: u32,
    bucket: u32,
    block: u32,
    origin: (u32, u32),
    grad: &[f32],
    inputs: &SplatInputs,
    frame: &RasterFrame,
    #[comptime] shape: KernelShape,
) {
    let channels = comptime!(shape.channels());
    let held = comptime!(shape.held());
    let lane = UNIT_POS;
    let plane = (frame.width * frame.height) as usize;
    let unit = block * comptime!(BLOCK_PIXELS as u32) + lane;
    let pixel = TilePixel::of(origin, pixel_of(unit), inputs, frame);
    let before = memory.checkpoints[(bucket * comptime!(TILE_PIXELS as u32) + unit) as usize];
    let mut through = select(before >= 0.0, 1.0f32, -1.0f32);
    let mut stopped = 0.0f32;
    let mut left = word;
    while left != 0 {
        let i = left.trailing_zeros();
        left &= left - 1;
        let (value, _) = S::seen(&S::load(&memory.splats, i as usize, inputs), &pixel, frame);
        let (alpha, next, stops) = layer(value, through, stopped, before, frame.transmittance_min);
        let at = (i * comptime!(STRIDE as u32) + lane) as usize;
        memory.alphas[at] = alpha;
        memory.weights[at] = alpha * (before * through);
        through = next;
        stopped = stops;
    }
    #[unroll(held)]
    for channel in 0..channels {
        row[comptime!(MOMENTS) + channel] = 0.0;
        if pixel.inside {
            row[comptime!(MOMENTS) + channel] = grad[plane_of(channel, shape) * plane + pixel.index];
        }
    }
    let mut behind = memory.rho[unit as usize];
    let mut left = word;
    while left != 0 {
        let i = 31u32 - left.leading_zeros();
        left ^= 1u32 << i;
        let at = (i * comptime!(STRIDE as u32) + lane) as usize;
        let alpha = memory.alphas[at];
        // Where a layer does not show, its features may be infinite or undefined.
        if alpha > 0.0 {
            let mut along = 0.0f32;
            let gaussian = memory.gaussians[i as usize] as usize;
            let mut depth = 0.0f32;
            if comptime!(S::ALONG_RAYS && shape.depth) {
                let (_, of_pixel) = S::seen(&S::load(&memory.splats, i as usize, inputs), &pixel, frame);
                depth = of_pixel;
            }
            #[unroll(held)]
            for channel in 0..channels {
                along += row[comptime!(MOMENTS) + channel] * colour::<S>(inputs, gaussian, channel, depth, shape);
            }
            let ahead = along - behind;
            behind += alpha * ahead;
            memory.alphas[at] = select(alpha < frame.alpha_max, memory.weights[at] * ahead, 0.0);
        }
    }
    memory.rho[unit as usize] = behind;
}

/// Adds a block's pixels to the rows, without the channels. The units are places.
#[cube]
pub(super) fn add_block<S: Splat>(
    row: &mut Array<f32>,
    memory: &SegmentMemory,
    block: u32,
    origin: (u32, u32),
    grad: &[f32],
    inputs: &SplatInputs,
    frame: &RasterFrame,
    #[comptime] shape: KernelShape,
    #[comptime] absolute: bool,
) {
    let lane = UNIT_POS;
    let plane = (frame.width * frame.height) as usize;
    let at = lane as usize * comptime!(STRIDE);
    let splat = S::load(&memory.splats, lane as usize, inputs);
    let first_unit = block * comptime!(BLOCK_PIXELS as u32);
    let pairs = BlockPairs { origin, first_unit, at: at as u32, plane };
    S::add_pairs(row, &splat, pairs, &memory.alphas, &memory.weights, grad, inputs, frame, shape, absolute);
}

/// Adds a block's pixels to the sums of channels. A unit has them behind its row, from `row[columns]` on: every
/// [`SIDE`]-th channel of [`SIDE`] places. Before that the units are pixels, which leave `g` in the table of `h`.
#[cube]
pub(super) fn add_channels(
    row: &mut Array<f32>,
    memory: &mut SegmentMemory,
    word: u32,
    #[comptime] columns: usize,
    #[comptime] len: usize,
) {
    let lane = UNIT_POS as usize;
    let first_place = lane / SIDE * SIDE;
    let at_once = comptime!(usize::min(len, SEGMENT_UNITS));
    let wide = comptime!(at_once / SIDE);
    #[unroll(len <= SEGMENT_UNITS)]
    for group in 0..comptime!(len.div_ceil(SEGMENT_UNITS)) {
        let first = group * comptime!(SEGMENT_UNITS);
        #[unroll]
        for k in 0..at_once {
            memory.alphas[k * comptime!(STRIDE) + lane] = row[comptime!(MOMENTS + k) + first];
        }
        sync_cube();
        let bits = word >> first_place as u32;
        if (bits & comptime!((1u32 << SIDE) - 1)) != 0 {
            let mut sums = Array::<f32>::new(comptime!(SIDE * wide));
            #[unroll]
            for t in 0..comptime!(SIDE * wide) {
                sums[t] = 0.0f32;
            }
            for pixel in 0..comptime!(BLOCK_PIXELS) {
                let mut gradients = Array::<f32>::new(wide);
                #[unroll]
                for j in 0..wide {
                    gradients[j] = memory.alphas[(lane % SIDE + comptime!(j * SIDE)) * comptime!(STRIDE) + pixel];
                }
                #[unroll]
                for i in 0..SIDE {
                    let weight = memory.weights[(first_place + i) * comptime!(STRIDE) + pixel];
                    #[unroll]
                    for j in 0..wide {
                        sums[comptime!(i * wide + j)] += weight * gradients[j];
                    }
                }
            }
            #[unroll]
            for t in 0..comptime!(SIDE * wide) {
                // The table has no weights of places that the block does not see.
                if ((bits >> comptime!((t / wide) as u32)) & 1) != 0 {
                    row[comptime!(columns + t) + first] += sums[t];
                }
            }
        }
        sync_cube();
    }
}
