//! Kernel of the backward pass before that over the layers: what lies behind each segment.

use cubecl::prelude::*;

use super::blocks::{BLOCK_PIXELS, BLOCKS, pixel_of};
use super::layer::{
    BUCKET, BUCKETS, Four, KernelShape, RasterFrame, SEGMENT, SplatInputs, TilePixel, add_compensated, first_slot,
    layer, tile_origin, transmittance_after_bucket,
};
use super::splat::{Splat, colour};
use super::trace::{TileRun, WORDS};
use crate::gpu::reduce::cube_sum;
use crate::intersect::TILE_PIXELS;

/// The least transmittance by which anything is divided: 2⁻¹⁰⁰. What lies behind less has no digit in any gradient.
pub(crate) const FAINTEST: f32 = 1.0 / (1u128 << 100) as f32;

/// Returns the plane of the picture that holds channel `channel`: alpha lies before depth.
#[cube]
pub(super) fn plane_of(channel: usize, #[comptime] shape: KernelShape) -> usize {
    let mut plane = channel;
    if comptime!(shape.depth) && channel == comptime!(shape.features) {
        plane = channel + 1;
    }
    plane
}

/// Writes `ρ = g·R` behind each segment, `[slot][unit]`, and the tile's share of the background's gradient,
/// `[tile][feature]`. A cube per tile, a unit per pixel.
///
/// The sums of the segments are weighted by the whole transmittance, so those behind a segment are added up from the last, and their total
/// is divided by the transmittance behind the segment. The picture's alpha, `1 − T`, acts as a background of colour minus one.
#[cube(launch_unchecked)]
pub(super) fn rasterize_suffix_kernel<S: Splat>(
    inputs: SplatInputs,
    background: &[f32],
    grad: &[f32],
    kept: &[f32],
    kept_words: &[u32],
    final_transmittance: &[f32],
    segment_count: &[u32],
    suffix_rho: &mut [f32],
    mut grad_background: ComptimeOption<Box<[f32]>>,
    frame: RasterFrame,
    run: TileRun,
    #[comptime] shape: KernelShape,
    #[comptime] _with_background: bool,
) {
    let channels = comptime!(shape.channels());
    let few = comptime!(shape.few());
    let tile = run.first_tile + CUBE_POS as u32;
    let unit = UNIT_POS;
    let mut shared = Shared::<[f32]>::new_slice(comptime!(TILE_PIXELS));
    let mut splats = Shared::<[Four]>::new_slice(comptime!(if few { 1 } else { SEGMENT * S::VECTORS }));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(if few { 1 } else { SEGMENT }));
    let mut words = Shared::<[u32]>::new_slice(comptime!(if few { 1 } else { WORDS }));
    if tile < run.end_tile {
        let pixel = TilePixel::of(tile_origin(tile, &frame), pixel_of(unit), &inputs, &frame);
        let plane = (frame.width * frame.height) as usize;
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        let slot = first_slot(first, tile) - run.first_slot;

        let mut own = Array::<f32>::new(channels);
        #[unroll(few)]
        for channel in 0..channels {
            own[channel] = 0.0f32;
            if pixel.inside {
                own[channel] = grad[plane_of(channel, shape) * plane + pixel.index];
            }
        }
        let mut farthest = 0.0f32;
        if comptime!(shape.grad_alpha) && pixel.inside {
            farthest = -grad[comptime!(shape.features) * plane + pixel.index];
        }
        #[unroll(few)]
        for channel in 0..comptime!(shape.features) {
            farthest += own[channel] * background[channel];
        }
        let mut behind = final_transmittance[tile as usize * comptime!(TILE_PIXELS) + unit as usize];
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_background {
            for channel in 0..comptime!(shape.features) {
                let sum = cube_sum(own[channel] * behind, &mut shared);
                if unit == 0 {
                    out[tile as usize * comptime!(shape.features) + channel] = sum;
                }
            }
        }

        let mut sum = farthest * behind;
        let mut lost = 0.0f32;
        let segments = segment_count[tile as usize];
        // DirectX wants a barrier between such a reading and a loop with barriers.
        sync_cube();
        for step in 0..segments {
            let segment = segments - 1 - step;
            let at_pixel = (slot + segment) as usize * comptime!(TILE_PIXELS) + unit as usize;
            suffix_rho[at_pixel] = select(behind > FAINTEST, sum / max(behind, FAINTEST), farthest);
            let at = (slot + segment) as usize * comptime!(shape.kept() * TILE_PIXELS) + unit as usize;
            let before = kept[at];
            let mut added = 0.0f32;
            if comptime!(few) {
                #[unroll]
                for channel in 0..channels {
                    added += own[channel] * kept[at + (channel + 1) * comptime!(TILE_PIXELS)];
                }
            } else {
                let place = segment * comptime!(SEGMENT as u32) + unit;
                if unit < comptime!(SEGMENT as u32) && place < places {
                    let gaussian = inputs.lists.gaussian(first + place);
                    gaussians[unit as usize] = gaussian;
                    let splat = S::of(&inputs, gaussian as usize, pixel.top, &frame);
                    S::store(&splat, &mut splats, unit as usize);
                }
                if unit < comptime!(WORDS as u32) {
                    words[unit as usize] = kept_words[((slot + segment) * comptime!(WORDS as u32) + unit) as usize];
                }
                sync_cube();
                let mut transmittance = before;
                for bucket in 0..comptime!(BUCKETS as u32) {
                    let mut word = 0u32;
                    // Nothing reads the sum in front of the first segment.
                    if transmittance >= 0.0 && segment > 0 {
                        word =
                            words[(bucket * comptime!(BLOCKS as u32) + unit / comptime!(BLOCK_PIXELS as u32)) as usize];
                    }
                    let mut through = 1.0f32;
                    let mut stopped = 0.0f32;
                    while word != 0 {
                        let i = word.trailing_zeros();
                        word &= word - 1;
                        let place = (bucket * comptime!(BUCKET as u32) + i) as usize;
                        let (value, depth) = S::seen(&S::load(&splats, place, &inputs), &pixel, &frame);
                        let (alpha, next, stops) =
                            layer(value, through, stopped, transmittance, frame.transmittance_min);
                        if alpha > 0.0 {
                            let mut along = 0.0f32;
                            for channel in 0..channels {
                                along += own[channel]
                                    * colour::<S>(&inputs, gaussians[place] as usize, channel, depth, shape);
                            }
                            added += alpha * (transmittance * through) * along;
                        }
                        through = next;
                        stopped = stops;
                        if through < 0.0 {
                            word = 0u32;
                        }
                    }
                    transmittance = transmittance_after_bucket(transmittance, through, stopped);
                }
                sync_cube();
            }
            let (total, lost_total) = add_compensated(sum, lost, added);
            sum = total;
            lost = lost_total;
            behind = before.abs();
        }
    }
}
