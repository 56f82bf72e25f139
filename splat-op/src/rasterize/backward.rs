//! Backward pass over the layers. None of its kernels divides by the share that a layer lets through.
//!
//! 1. *Suffix* (`suffix.rs`), a cube per tile: computes `ρ = g·R` behind each segment, the part of the colour behind it
//!    that the gradient depends on.
//! 2. *Layers* (this file), a cube per segment, all segments of all tiles at once, however long a tile's list is:
//!    computes the sums of each intersection over the tile's pixels, a row per intersection.
//! 3. *Gather* (`gather.rs`), a unit per Gaussian: turns the rows into gradients of the ellipse and the features.
//!
//! Rows are either added to one row per Gaussian, in whatever order the device takes them, or kept one per intersection
//! and added in the order of the intersections, which gives the same bits in every run.

use cubecl::prelude::*;

use super::blocks::{BLOCK, BLOCKS, HEIGHT, WIDTH, pixel_of};
use super::forward::WORDS;
use super::layer::{
    BUCKET, BUCKETS, FOOTPRINT, Four, KernelShape, LayerEllipse, RasterFrame, SEGMENT, TilePixel, colour, colours_of,
    first_slot, layer, tile_origin, transmittance_after_bucket,
};
use super::suffix::plane_of;
use super::trace::TileRun;
use crate::gpu::atomic::FloatCell;
use crate::intersect::TILE_PIXELS;
use crate::intersect::forward::TileLists;

/// Number of units of a cube: of the pixels in a block and of the places in a bucket.
pub(super) const LANES: usize = 32;
const _: () = assert!(BLOCK == LANES && BUCKET == LANES && WORDS == LANES);

/// Distance of the rows of a table of places and pixels. Neither direction of reading has bank conflicts.
const STRIDE: usize = LANES + 1;

/// Number of channels, of many, that are read together.
const GROUP: usize = 8;

/// Number of moments: the sums of `h, h u, h v, h u², h u v, h v²` with `h = α ∂L/∂α` where alpha is not at its limit.
/// In a row the channels follow, then the two sums of absolute values if they are wanted.
pub(crate) const MOMENTS: usize = 6;

/// Number of values in a row.
pub(crate) const fn row_len(shape: KernelShape, absolute: bool) -> usize {
    MOMENTS + shape.channels() + if absolute { 2 } else { 0 }
}

/// Computes the rows of each segment's intersections. A cube goes forwards through the segment for the transmittances
/// before its buckets, then backwards bucket by bucket and, within a bucket, block by block.
///
/// At a block, its units are first pixels. They go forwards through the bits of the block's word for `α` and `T`, then
/// backwards for `∂L/∂α`, and leave `h` and the weights `α T` in tables in shared memory. Then the units are places:
/// they read the tables transposed, and each adds up its own row over the pixels. So a pair's exponential is computed
/// once for its gradient and at most once for its transmittance, and sums need neither atomics nor shuffles.
///
/// Without `add`, the rows of the intersections `first_row..end_row` are written to `rows`, and segments without any of
/// them are skipped. With `add`, rows are added to `sums`, one row per Gaussian.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_kernel<A: FloatCell>(
    projected: &[f32],
    features: &[f32],
    grad: &[f32],
    lists: TileLists,
    kept: &[f32],
    kept_words: &[u32],
    tile_of_slot: &[u32],
    segment_count: &[u32],
    suffix_rho: &[f32],
    rows: &mut [f32],
    sums: &[A],
    frame: RasterFrame,
    run: TileRun,
    slots: u32,
    first_row: u32,
    end_row: u32,
    #[comptime] shape: KernelShape,
    #[comptime] absolute: bool,
    #[comptime] add: bool,
) {
    let channels = comptime!(shape.channels());
    let few = comptime!(shape.few());
    let columns = comptime!(row_len(shape, absolute));
    let mut words = Shared::<[u32]>::new_slice(comptime!(WORDS));
    // The transmittances before each bucket, and `ρ` behind the layers still to pass.
    let mut checkpoints = Shared::<[f32]>::new_slice(comptime!(BUCKETS * TILE_PIXELS));
    let mut rho = Shared::<[f32]>::new_slice(comptime!(TILE_PIXELS));
    // Of the bucket: `alphas` holds alphas at first, then `h`.
    let mut ellipses = Shared::<[Four]>::new_slice(comptime!(BUCKET * FOOTPRINT));
    let mut colours = Shared::<[Four]>::new_slice(comptime!(if few { BUCKET } else { 1 }));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(if few { 1 } else { BUCKET }));
    // Rows that the sums are written or added to.
    let mut targets = Shared::<[u32]>::new_slice(comptime!(BUCKET));
    let mut alphas = Shared::<[f32]>::new_slice(comptime!(BUCKET * STRIDE));
    let mut weights = Shared::<[f32]>::new_slice(comptime!(BUCKET * STRIDE));
    // Of the block: `g` of its pixels.
    let mut gradients = Shared::<[f32]>::new_slice(comptime!(if few { BLOCK * channels } else { 1 }));

    let slot = CUBE_POS as u32;
    if slot < slots {
        let lane = UNIT_POS;
        let tile = tile_of_slot[slot as usize];
        let first = lists.start(tile);
        let places = lists.start(tile + 1) - first;
        let segment = slot - (first_slot(first, tile) - run.first_slot);
        let start = segment * comptime!(SEGMENT as u32);
        // The last slot of a tile may have no places.
        let mut wanted = start < places;
        if comptime!(!add) {
            // Intersections ascend along a tile's list.
            let begin = first + start;
            if wanted {
                let last = begin + min(places - start, comptime!(SEGMENT as u32)) - 1;
                wanted = lists.intersection(begin) < end_row && lists.intersection(last) >= first_row;
            }
        }
        let passed = wanted && segment < segment_count[tile as usize];
        // DirectX wants a barrier between such readings and a branch with barriers.
        sync_cube();
        if wanted && !passed && comptime!(!add) {
            // All pixels were finished before.
            let mut place = start + lane;
            while place < min(places, start + comptime!(SEGMENT as u32)) {
                let target = lists.intersection(first + place) - first_row;
                if target < end_row - first_row {
                    for column in 0..columns {
                        rows[target as usize * columns + column] = 0.0f32;
                    }
                }
                place += comptime!(LANES as u32);
            }
        }
        if passed {
            let count = min(places - start, comptime!(SEGMENT as u32));
            let buckets = (count + comptime!(BUCKET as u32 - 1)) / comptime!(BUCKET as u32);
            let origin = tile_origin(tile, &frame);
            let (_, pixel_row) = origin;
            let top = f32::cast_from(pixel_row) + 0.5;
            let plane = (frame.width * frame.height) as usize;
            words[lane as usize] = kept_words[(slot * comptime!(WORDS as u32) + lane) as usize];
            for block in 0..comptime!(BLOCKS as u32) {
                let unit = (block * comptime!(BLOCK as u32) + lane) as usize;
                checkpoints[unit] = kept[slot as usize * comptime!(shape.kept() * TILE_PIXELS) + unit];
                rho[unit] = suffix_rho[slot as usize * comptime!(TILE_PIXELS) + unit];
            }

            // Forwards.
            for bucket in 0..buckets - 1 {
                // Every bucket but the last is full.
                let gaussian = lists.gaussian(first + start + bucket * comptime!(BUCKET as u32) + lane) as usize;
                LayerEllipse::of(projected, gaussian, top).store(&mut ellipses, lane as usize);
                sync_cube();
                for block in 0..comptime!(BLOCKS as u32) {
                    let unit = block * comptime!(BLOCK as u32) + lane;
                    let pixel = TilePixel::of(origin, pixel_of(unit), &frame);
                    let at = (bucket * comptime!(TILE_PIXELS as u32) + unit) as usize;
                    let before = checkpoints[at];
                    let mut word = 0u32;
                    if before >= 0.0 {
                        word = words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
                    }
                    let mut through = 1.0f32;
                    let mut stopped = 0.0f32;
                    while word != 0 {
                        let i = word.trailing_zeros();
                        word &= word - 1;
                        let value = LayerEllipse::load(&ellipses, i as usize).alpha(pixel.x, pixel.row, &frame);
                        let (_, next, stops) = layer(value, through, stopped, before, frame.transmittance_min);
                        through = next;
                        stopped = stops;
                        if through < 0.0 {
                            word = 0u32;
                        }
                    }
                    checkpoints[at + comptime!(TILE_PIXELS)] = transmittance_after_bucket(before, through, stopped);
                }
                sync_cube();
            }

            // Backwards.
            for back in 0..buckets {
                let bucket = buckets - 1 - back;
                let bucket_start = start + bucket * comptime!(BUCKET as u32);
                let here = min(places - bucket_start, comptime!(BUCKET as u32));
                if lane < here {
                    let intersection = lists.intersection(first + bucket_start + lane);
                    let gaussian = lists.gaussian_of_intersection[intersection as usize];
                    LayerEllipse::of(projected, gaussian as usize, top).store(&mut ellipses, lane as usize);
                    targets[lane as usize] = if comptime!(add) { gaussian } else { intersection - first_row };
                    if comptime!(few) {
                        colours[lane as usize] = colours_of(projected, features, gaussian as usize, shape);
                    } else {
                        gaussians[lane as usize] = gaussian;
                    }
                }
                let mut row = Array::<f32>::new(columns);
                #[unroll(few)]
                for column in 0..columns {
                    row[column] = 0.0f32;
                }
                sync_cube();

                for block in 0..comptime!(BLOCKS as u32) {
                    let word = words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
                    if word != 0 {
                        // The units are pixels.
                        let unit = block * comptime!(BLOCK as u32) + lane;
                        let pixel = TilePixel::of(origin, pixel_of(unit), &frame);
                        let before = checkpoints[(bucket * comptime!(TILE_PIXELS as u32) + unit) as usize];
                        let mut through = select(before >= 0.0, 1.0f32, -1.0f32);
                        let mut stopped = 0.0f32;
                        let mut left = word;
                        while left != 0 {
                            let i = left.trailing_zeros();
                            left &= left - 1;
                            let value = LayerEllipse::load(&ellipses, i as usize).alpha(pixel.x, pixel.row, &frame);
                            let (alpha, next, stops) = layer(value, through, stopped, before, frame.transmittance_min);
                            let at = (i * comptime!(STRIDE as u32) + lane) as usize;
                            alphas[at] = alpha;
                            weights[at] = alpha * (before * through);
                            through = next;
                            stopped = stops;
                        }
                        let mut gradient = Array::<f32>::new(comptime!(if few { channels } else { 1 }));
                        if comptime!(few) {
                            #[unroll]
                            for channel in 0..channels {
                                let mut value = 0.0f32;
                                if pixel.inside {
                                    value = grad[plane_of(channel, shape) * plane + pixel.index];
                                }
                                gradient[channel] = value;
                                gradients[channel * comptime!(BLOCK) + lane as usize] = value;
                            }
                        }
                        let mut behind = rho[unit as usize];
                        let mut left = word;
                        while left != 0 {
                            let i = 31u32 - left.leading_zeros();
                            left ^= 1u32 << i;
                            let at = (i * comptime!(STRIDE as u32) + lane) as usize;
                            let alpha = alphas[at];
                            // Where a layer does not show, its features may be infinite or undefined.
                            if alpha > 0.0 {
                                let mut along = 0.0f32;
                                if comptime!(few) {
                                    let all = colours[i as usize];
                                    #[unroll]
                                    for channel in 0..channels {
                                        along += gradient[channel] * all.extract(channel);
                                    }
                                } else {
                                    let gaussian = gaussians[i as usize] as usize;
                                    along =
                                        along_channels(projected, features, grad, gaussian, pixel.index, plane, shape);
                                }
                                let ahead = along - behind;
                                behind += alpha * ahead;
                                alphas[at] = select(alpha < frame.alpha_max, weights[at] * ahead, 0.0);
                            }
                        }
                        rho[unit as usize] = behind;
                    }
                    // Outside the branch: DirectX refuses barriers in branches on what was read.
                    sync_cube();

                    // The units are places.
                    if ((word >> lane) & 1) != 0 {
                        let ellipse = LayerEllipse::load(&ellipses, lane as usize);
                        let corner = TilePixel::of(origin, pixel_of(block * comptime!(BLOCK as u32)), &frame);
                        let at = lane as usize * comptime!(STRIDE);
                        add_moments(&mut row, &alphas, at, ellipse, corner, shape, absolute);
                        if comptime!(few) {
                            #[unroll]
                            for channel in 0..channels {
                                let mut sum = 0.0f32;
                                for other in 0..comptime!(BLOCK) {
                                    sum += weights[at + other] * gradients[channel * comptime!(BLOCK) + other];
                                }
                                row[comptime!(MOMENTS) + channel] += sum;
                            }
                        } else {
                            for channel in 0..channels {
                                let first = plane_of(channel, shape) * plane + corner.index;
                                let mut sum = 0.0f32;
                                for step in 0..comptime!(HEIGHT) {
                                    #[unroll]
                                    for column in 0..comptime!(WIDTH) {
                                        let weight = weights[at + step * comptime!(WIDTH) + column];
                                        // A pixel outside the picture has no weight.
                                        if weight > 0.0 {
                                            sum += weight * grad[first + step * frame.width as usize + column];
                                        }
                                    }
                                }
                                row[comptime!(MOMENTS) + channel] += sum;
                            }
                        }
                    }
                    sync_cube();
                }

                if comptime!(few) {
                    // Through shared memory, so that neighbouring units write neighbouring values.
                    #[unroll]
                    for column in 0..columns {
                        alphas[lane as usize * comptime!(STRIDE) + column] = row[column];
                    }
                    sync_cube();
                    let mut i = lane;
                    while i < here * comptime!(columns as u32) {
                        let place = i / comptime!(columns as u32);
                        let column = i % comptime!(columns as u32);
                        let sum = alphas[(place * comptime!(STRIDE as u32) + column) as usize];
                        let target = targets[place as usize];
                        let cell = target as usize * columns + column as usize;
                        if comptime!(add) {
                            if sum != 0.0 {
                                A::add(&sums[cell], sum);
                            }
                        } else if target < end_row - first_row {
                            rows[cell] = sum;
                        }
                        i += comptime!(LANES as u32);
                    }
                } else if lane < here {
                    let target = targets[lane as usize];
                    for column in 0..columns {
                        let cell = target as usize * columns + column;
                        if comptime!(add) {
                            if row[column] != 0.0 {
                                A::add(&sums[cell], row[column]);
                            }
                        } else if target < end_row - first_row {
                            rows[cell] = row[column];
                        }
                    }
                }
                sync_cube();
            }
        }
    }
}

/// Returns `Σ g c` over the channels of a Gaussian at pixel `index` of the picture, whose planes have `plane` pixels.
#[cube]
fn along_channels(
    projected: &[f32],
    features: &[f32],
    grad: &[f32],
    gaussian: usize,
    index: usize,
    plane: usize,
    #[comptime] shape: KernelShape,
) -> f32 {
    let groups = comptime!(shape.channels() / GROUP);
    let mut sum = 0.0f32;
    for group in 0..groups {
        #[unroll]
        for k in 0..comptime!(GROUP) {
            let channel = group * comptime!(GROUP) + k;
            let gradient = grad[plane_of(channel, shape) * plane + index];
            sum += gradient * colour(projected, features, gaussian, channel, shape);
        }
    }
    #[unroll]
    for k in 0..comptime!(shape.channels() % GROUP) {
        let channel = comptime!(groups * GROUP + k);
        sum += grad[plane_of(channel, shape) * plane + index] * colour(projected, features, gaussian, channel, shape);
    }
    sum
}

/// Adds the moments over a block's pixels, and the sums of absolute values, to the row of a place. Its values of `h` lie
/// from `at` on. `corner` is the block's first pixel.
#[cube]
fn add_moments(
    row: &mut Array<f32>,
    h: &Shared<[f32]>,
    at: usize,
    ellipse: LayerEllipse,
    corner: TilePixel,
    #[comptime] shape: KernelShape,
    #[comptime] absolute: bool,
) {
    let slope = ellipse.inverse_v * ellipse.shear;
    for column in 0..comptime!(WIDTH as u32) {
        let (u, below) = ellipse.along_column(corner.x + f32::cast_from(column));
        // Down the column `u` is the same.
        let mut h_sum = 0.0f32;
        let mut hv_sum = 0.0f32;
        let mut hvv_sum = 0.0f32;
        #[unroll]
        for step in 0..comptime!(HEIGHT) {
            let h = h[at + column as usize + comptime!(step * WIDTH)];
            let v = (below + (corner.row + comptime!(step as f32))) * ellipse.inverse_v;
            let hv = h * v;
            h_sum += h;
            hv_sum += hv;
            hvv_sum += hv * v;
            if comptime!(absolute) {
                row[comptime!(MOMENTS + shape.channels())] += (h * u * ellipse.inverse_u - hv * slope).abs();
                row[comptime!(MOMENTS + shape.channels() + 1)] += (hv * ellipse.inverse_v).abs();
            }
        }
        row[0] += h_sum;
        row[1] += h_sum * u;
        row[2] += hv_sum;
        row[3] += h_sum * u * u;
        row[4] += hv_sum * u;
        row[5] += hvv_sum;
    }
}
