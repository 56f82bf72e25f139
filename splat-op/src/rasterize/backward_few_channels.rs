//! Backward kernel over the layers of a bucket, for few channels. A unit has a strip of pixels, some rows of one column
//! of a tile, whose values stay in registers.
//!
//! A cube takes a bucket four places at a time, from the last to the first. A forward pass through the whole bucket
//! stores `T` before each four places; a second pass over the four gives their `α` and `T`. The exponentials are
//! computed twice, but there is neither a division by `1 − α` nor a store per pixel and place. Sums over a unit's
//! pixels stay in registers; only the sums of the units meet, in shared memory, once per four places. The transposed
//! scheme of `backward_many_channels.rs` passes eleven numbers through shared memory for each pair of a Gaussian and a
//! pixel, this one three for every eighth pair.

use cubecl::prelude::*;

use super::backward::{row_len, tile_of};
use super::layer::{BUCKET, FOOTPRINT, KernelShape, LayerEllipse, RasterFrame, colour, first_bucket, strip_origin};
use super::pixels::{STEP, STRIP, UnitPixels};
use crate::gpu::atomic::FloatCell;
use crate::intersect::TILE_PIXELS;
use crate::intersect::forward::TileLists;

/// Number of units of a cube.
pub(super) const FEW_UNITS: usize = TILE_PIXELS / STRIP;

/// Computes the rows of each bucket's intersections.
///
/// Without `add`, every intersection's row is written to `rows`, `[H, row]`. With `add`, rows are added to `sums`, one
/// row per Gaussian.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_few_channels_kernel<A: FloatCell>(
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
    let channels = comptime!(shape.channels());
    let columns = comptime!(row_len(shape, absolute));
    let pixels = comptime!(STRIP);
    let units = comptime!(FEW_UNITS);
    let mut footprints = Shared::<[f32]>::new_slice(comptime!(BUCKET * FOOTPRINT));
    let mut colours = Shared::<[f32]>::new_slice(comptime!(BUCKET * channels));
    let mut intersections = Shared::<[u32]>::new_slice(comptime!(BUCKET));
    let mut partial = Shared::<[f32]>::new_slice(comptime!(STEP * columns * (units + 1)));

    let bucket_index = CUBE_POS as u32;
    if bucket_index < max_buckets {
        let tile = tile_of(&lists, 0, frame.tiles_x * frame.tiles_y, bucket_index, true);
        let first = lists.start(tile);
        let places = lists.start(tile + 1) - first;
        let bucket = bucket_index - first_bucket(first, tile);
        let place = bucket * comptime!(BUCKET as u32);
        if place < places {
            let count = min(places - place, comptime!(BUCKET as u32));
            let steps = (count + comptime!(STEP as u32 - 1)) / comptime!(STEP as u32);
            let mut i = UNIT_POS;
            while i < steps * comptime!(STEP as u32) {
                let mut intersection = 0u32;
                let mut gaussian = 0u32;
                if i < count {
                    intersection = lists.intersection(first + place + i);
                    gaussian = lists.gaussian_of_intersection[intersection as usize];
                    LayerEllipse::of(projected, gaussian as usize).store(&mut footprints, i as usize);
                } else {
                    LayerEllipse::nowhere().store(&mut footprints, i as usize);
                }
                intersections[i as usize] = if comptime!(add) { gaussian } else { intersection };
                #[unroll]
                for channel in 0..channels {
                    // Colours beyond the last intersection are zero: the colour of another Gaussian, times zero, may be
                    // NaN.
                    let value = colour(projected, features, gaussian as usize, channel, shape);
                    colours[i as usize * channels + channel] = select(i < count, value, 0.0f32);
                }
                i += comptime!(units as u32);
            }
            sync_cube();

            if bucket >= bucket_count[tile as usize] {
                if comptime!(!add) {
                    let mut i = UNIT_POS;
                    while i < count * comptime!(columns as u32) {
                        let intersection = intersections[(i / comptime!(columns as u32)) as usize] as usize;
                        rows[intersection * columns + (i % comptime!(columns as u32)) as usize] = 0.0f32;
                        i += comptime!(units as u32);
                    }
                }
            } else {
                let (column, row) = strip_origin(UNIT_POS, pixels);
                let mut at = UnitPixels::new(tile, column, row, frame, shape);
                #[unroll]
                for p in 0..pixels {
                    at.load(kept, suffix_rho, grad, bucket_index, tile, column, row, frame, shape, p);
                }

                // Forwards: the shares that the layers before each step let through and stop.
                let mut checkpoints = Array::<f32>::new(comptime!(BUCKET / STEP * pixels));
                for step in 0..steps {
                    let base = step as usize * pixels;
                    #[unroll]
                    for p in 0..pixels {
                        checkpoints[base + p] = at.checkpoint(p);
                    }
                    // No step follows the last.
                    let end = select(step + 1 < steps, (step + 1) * comptime!(STEP as u32), 0u32);
                    for i in step * comptime!(STEP as u32)..end {
                        let footprint = LayerEllipse::load(&footprints, i as usize);
                        #[unroll]
                        for p in 0..pixels {
                            at.pass(footprint, &frame, shape, p);
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
                        at.restore(checkpoints[base + p], p);
                    }
                    #[unroll]
                    for k in 0..comptime!(STEP) {
                        let footprint = LayerEllipse::load(&footprints, start as usize + k);
                        #[unroll]
                        for p in 0..pixels {
                            let (alpha, weight) = at.pass(footprint, &frame, shape, p);
                            alphas[comptime!(k * pixels + p)] = alpha;
                            weights[comptime!(k * pixels + p)] = weight;
                        }
                    }
                    #[unroll]
                    for from_end in 0..comptime!(STEP) {
                        let k = comptime!(STEP - 1 - from_end);
                        let mut colour_here = Array::<f32>::new(channels);
                        let mut own = Array::<f32>::new(columns);
                        #[unroll]
                        for channel in 0..channels {
                            colour_here[channel] = colours[(start as usize + k) * channels + channel];
                        }
                        #[unroll]
                        for column in 0..columns {
                            own[column] = 0.0f32;
                        }
                        at.add_sums(
                            LayerEllipse::load(&footprints, start as usize + k),
                            &colour_here,
                            &alphas,
                            &weights,
                            &mut own,
                            frame.alpha_max,
                            shape,
                            absolute,
                            k,
                        );
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
                            let cell = intersections[i as usize] as usize * columns
                                + (pair % comptime!(columns as u32)) as usize;
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
