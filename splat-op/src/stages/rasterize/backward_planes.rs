//! The pass over the layers, for devices whose planes exchange values and wait; `backward.rs` has the form for all others.
//!
//! A unit is a pixel while it passes the layers of its block, and a row of eight pixels of one layer while sums are made: what a
//! layer gives each pixel goes through a small table of the plane's own in shared memory. So a sum over 32 pixels takes eight
//! additions and two shuffles, and no plane waits for another.

use cubecl::prelude::*;

use super::MOMENTS;
use super::backward::{row_len, store_cell};
use super::blocks::{BLOCK_PIXELS, BLOCK_WIDTH, BLOCKS, pixel_of};
use super::ellipse::LayerEllipse;
use super::layer::{BUCKET, Four, KernelShape, RasterFrame, SEGMENT, SplatInputs, TilePixel, layer, tile_origin};
use super::segment::{KeptTrace, Segment, SegmentRange, clear_rows};
use super::splat::{Splat, behind_word, colours_of};
use super::suffix::plane_of;
use super::trace::WORDS;
use crate::gpu::atomic::FloatCell;
use crate::intersect::TILE_PIXELS;

/// Number of layers that a plane sums at a time. A unit keeps their alphas in registers on its way forwards.
const TOGETHER: usize = 8;

/// Number of pixels that a unit sums: a row of a block.
const RUN_PIXELS: usize = BLOCK_WIDTH;

/// Sizes of planes that the kernel is written for. A block's pixels are whole planes.
pub(crate) const PLANES: [u32; 2] = [8, 32];

/// Number of sums in shared memory. Planes that add to the rows of Gaussians themselves need none.
const fn partial_len(columns: usize, direct: bool) -> usize {
    if direct { 1 } else { TILE_PIXELS * columns }
}

/// Numbers of a table: a row of a plane's pixels for each of its layers, and one more, so that the units that read a column are
/// served at once.
const fn table_len(plane_units: usize) -> usize {
    TILE_PIXELS / plane_units * TOGETHER * (plane_units + 1)
}

/// Bytes of shared memory that the kernel takes.
pub(super) const fn shared_bytes(shape: KernelShape, columns: usize, plane_units: usize, direct: bool) -> usize {
    let of_segment = SEGMENT * (4 * LayerEllipse::VECTORS + 4 + 1) + WORDS;
    let of_planes = 2 * table_len(plane_units) + TILE_PIXELS / plane_units * TOGETHER;
    4 * (of_segment + of_planes + TILE_PIXELS * shape.channels() + partial_len(columns, direct))
}

/// Does what `rasterize_backward_kernel` does, for few channels. A cube of a unit per pixel takes a segment.
///
/// In a bucket, the units of a block pass the layers of the block's word from the last to the first, eight at a time: forwards for
/// `α` and `T`, which stay in registers, then backwards for `∂L/∂α`. Layers before these eight are evaluated once more for their
/// transmittance.
///
/// With `direct`, every plane adds its sums to the rows of the Gaussians. Without, the planes of a cube meet after each bucket and
/// add up their sums in a fixed order first: where the order matters, or an addition is dear.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_planes_kernel<A: FloatCell>(
    inputs: SplatInputs,
    grad: &[f32],
    trace: KeptTrace,
    rows: &mut [f32],
    sums: &[A],
    frame: RasterFrame,
    range: SegmentRange,
    #[comptime] shape: KernelShape,
    #[comptime] absolute: bool,
    #[comptime] add: bool,
    #[comptime] plane_units: u32,
    #[comptime] direct: bool,
) {
    let channels = comptime!(shape.channels());
    let columns = comptime!(row_len::<LayerEllipse>(shape, absolute));
    // Places whose sums are in shared memory at a time: a row for each plane and place, 256 rows.
    let part_places = comptime!(if direct { BUCKET as u32 } else { plane_units });
    let mut words = Shared::<[u32]>::new_slice(comptime!(WORDS));
    let mut ellipses = Shared::<[Four]>::new_slice(comptime!(SEGMENT * LayerEllipse::VECTORS));
    let mut colours = Shared::<[Four]>::new_slice(comptime!(SEGMENT));
    let mut targets = Shared::<[u32]>::new_slice(comptime!(SEGMENT));
    let mut gradients = Shared::<[f32]>::new_slice(comptime!(TILE_PIXELS * channels));
    // Of each plane, for the layers of a group: `h` and the weights `α T` of its pixels, and the places of the layers in the bucket.
    let mut heights = Shared::<[f32]>::new_slice(comptime!(table_len(plane_units as usize)));
    let mut shares = Shared::<[f32]>::new_slice(comptime!(table_len(plane_units as usize)));
    let mut group = Shared::<[u32]>::new_slice(comptime!(TILE_PIXELS / plane_units as usize * TOGETHER));
    let mut partial = Shared::<[f32]>::new_slice(comptime!(partial_len(columns, direct)));

    let slot = CUBE_POS as u32;
    if slot < range.slots {
        let unit = UNIT_POS;
        let block = unit / comptime!(BLOCK_PIXELS as u32);
        let plane_index = unit / plane_units;
        let lane = unit % plane_units;
        let segment = Segment::of(slot, &inputs.lists, &trace, &range, add);
        // DirectX wants a barrier between such readings and a branch with barriers.
        sync_cube();
        if comptime!(!add) {
            clear_rows(&segment, &inputs.lists, rows, &range, columns);
        }
        if segment.passed {
            let count = segment.count;
            let buckets = segment.buckets;
            let origin = tile_origin(segment.tile, &frame);
            let pixel = TilePixel::of(origin, pixel_of(unit), &inputs, &frame);
            let plane = (frame.width * frame.height) as usize;
            // Two units load a Gaussian.
            let i = unit % comptime!(SEGMENT as u32);
            if i < count {
                let intersection = inputs.lists.intersection(segment.first + segment.start + i);
                let gaussian = inputs.lists.gaussian_of_intersection[intersection as usize];
                if unit < comptime!(SEGMENT as u32) {
                    let ellipse = LayerEllipse::of(&inputs, gaussian as usize, pixel.top, &frame);
                    LayerEllipse::store(&ellipse, &mut ellipses, i as usize);
                } else {
                    colours[i as usize] = colours_of::<LayerEllipse>(&inputs, gaussian as usize, shape);
                    targets[i as usize] = if comptime!(add) { gaussian } else { intersection - range.first_row };
                }
            }
            if unit < comptime!(WORDS as u32) {
                words[unit as usize] = trace.words[(slot * comptime!(WORDS as u32) + unit) as usize];
            }
            let mut gradient = Array::<f32>::new(channels);
            #[unroll]
            for channel in 0..channels {
                gradient[channel] = 0.0f32;
                if pixel.inside {
                    gradient[channel] = grad[plane_of(channel, shape) * plane + pixel.index];
                }
                gradients[comptime!(channel * TILE_PIXELS) + unit as usize] = gradient[channel];
            }
            // The layer of the group and the pixels that this unit sums.
            let own_layer = lane / comptime!(plane_units / RUN_PIXELS as u32);
            let run_in_plane = lane % comptime!(plane_units / RUN_PIXELS as u32) * comptime!(RUN_PIXELS as u32);
            let run_start = plane_index * plane_units + run_in_plane;
            let first_of_run = TilePixel::of(origin, pixel_of(run_start), &inputs, &frame);
            let run_x = first_of_run.x;
            let run_row = first_of_run.row;
            let table_row = comptime!(plane_units as usize + 1);
            let table = plane_index as usize * comptime!(TOGETHER * (plane_units as usize + 1));
            let mut behind = trace.suffix_rho[slot as usize * comptime!(TILE_PIXELS) + unit as usize];
            let at_start = trace.kept[slot as usize * comptime!(shape.kept() * TILE_PIXELS) + unit as usize];
            sync_cube();

            // Forwards: the transmittances before the buckets.
            let mut before_second = at_start;
            let mut before_third = at_start;
            let mut before_fourth = at_start;
            let mut current = at_start;
            for bucket in 0..buckets - 1 {
                let mut word = 0u32;
                if current >= 0.0 {
                    word = words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
                }
                let first = bucket * comptime!(BUCKET as u32);
                current = behind_word::<LayerEllipse>(&ellipses, first, word, current, &pixel, &inputs, &frame);
                before_second = select(bucket == 0, current, before_second);
                before_third = select(bucket == 1, current, before_third);
                before_fourth = select(bucket == 2, current, before_fourth);
            }

            // Backwards.
            for back in 0..buckets {
                let bucket = buckets - 1 - back;
                let early = select(bucket == 0, at_start, before_second);
                let before = select(bucket < 2, early, select(bucket == 2, before_third, before_fourth));
                let bucket_start = bucket * comptime!(BUCKET as u32);
                let whole_word = words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
                for back_part in 0..comptime!(BUCKET as u32 / part_places) {
                    let first_place = comptime!(BUCKET as u32 - part_places) - back_part * part_places;
                    let part_bits = comptime!(u32::MAX >> (BUCKET as u32 - part_places)) << first_place;
                    let layers = (whole_word & part_bits).count_ones();
                    let earlier = (whole_word & ((1u32 << first_place) - 1)).count_ones();
                    let groups = (layers + comptime!(TOGETHER as u32 - 1)) / comptime!(TOGETHER as u32);
                    for turn in 0..groups {
                        let in_part = (groups - 1 - turn) * comptime!(TOGETHER as u32);
                        let mut left = whole_word;
                        let mut through = select(before >= 0.0, 1.0f32, -1.0f32);
                        let mut stopped = 0.0f32;
                        for _ in 0..earlier + in_part {
                            let i = bucket_start + left.trailing_zeros();
                            left &= left - 1;
                            let value =
                                LayerEllipse::load(&ellipses, i as usize, &inputs).alpha(pixel.x, pixel.row, &frame);
                            let (_, next, stops) = layer(value, through, stopped, before, frame.transmittance_min);
                            through = next;
                            stopped = stops;
                        }
                        let here = min(layers - in_part, comptime!(TOGETHER as u32));
                        let mut alphas = Array::<f32>::new(comptime!(TOGETHER));
                        let mut weights = Array::<f32>::new(comptime!(TOGETHER));
                        let mut group_places = Array::<u32>::new(comptime!(TOGETHER));
                        #[unroll]
                        for k in 0..comptime!(TOGETHER) {
                            alphas[k] = 0.0f32;
                            weights[k] = 0.0f32;
                            group_places[k] = 0u32;
                            if comptime!(k as u32) < here {
                                let i = left.trailing_zeros();
                                left &= left - 1;
                                group_places[k] = i;
                                let place = (bucket_start + i) as usize;
                                let value =
                                    LayerEllipse::load(&ellipses, place, &inputs).alpha(pixel.x, pixel.row, &frame);
                                let (alpha, next, stops) =
                                    layer(value, through, stopped, before, frame.transmittance_min);
                                alphas[k] = alpha;
                                weights[k] = alpha * (before * through);
                                through = next;
                                stopped = stops;
                            }
                        }
                        #[unroll]
                        for back in 0..comptime!(TOGETHER) {
                            let k = comptime!(TOGETHER - 1 - back);
                            if comptime!(k as u32) < here {
                                let all = colours[(bucket_start + group_places[k]) as usize];
                                let mut along = 0.0f32;
                                #[unroll]
                                for channel in 0..channels {
                                    along += gradient[channel] * all.extract(channel);
                                }
                                // Where the layer does not show, its features may be infinite or undefined.
                                let ahead = select(alphas[k] > 0.0, along - behind, 0.0);
                                behind += alphas[k] * ahead;
                                let at = table + comptime!(k * (plane_units as usize + 1)) + lane as usize;
                                heights[at] = select(alphas[k] < frame.alpha_max, weights[k] * ahead, 0.0);
                                shares[at] = weights[k];
                                if lane == 0 {
                                    group[plane_index as usize * TOGETHER + k] = group_places[k];
                                }
                            }
                        }
                        sync_plane();
                        let mut values = Array::<f32>::new(columns);
                        #[unroll]
                        for column in 0..columns {
                            values[column] = 0.0f32;
                        }
                        let mut row = 0usize;
                        if own_layer < here {
                            let in_bucket = group[plane_index as usize * TOGETHER + own_layer as usize];
                            let place = (bucket_start + in_bucket) as usize;
                            row = (plane_index * part_places + in_bucket - first_place) as usize;
                            if comptime!(direct) {
                                row = targets[place] as usize;
                            }
                            let ellipse = LayerEllipse::load(&ellipses, place, &inputs);
                            let at = table + own_layer as usize * table_row + run_in_plane as usize;
                            #[unroll]
                            for i in 0..comptime!(RUN_PIXELS) {
                                let h = heights[at + i];
                                let share = shares[at + i];
                                let (u, below) = ellipse.along_column(run_x + comptime!(i as f32));
                                let v = (below + run_row) * ellipse.inverse_v;
                                let hu = h * u;
                                let hv = h * v;
                                values[0] += h;
                                values[1] += hu;
                                values[2] += hv;
                                values[3] += hu * u;
                                values[4] += hv * u;
                                values[5] += hv * v;
                                #[unroll]
                                for channel in 0..channels {
                                    let of_pixel = gradients[comptime!(channel * TILE_PIXELS + i) + run_start as usize];
                                    values[comptime!(MOMENTS + channel)] += share * of_pixel;
                                }
                                if comptime!(absolute) {
                                    let slope = ellipse.inverse_v * ellipse.shear;
                                    values[comptime!(MOMENTS + channels)] +=
                                        (hu * ellipse.inverse_u - hv * slope).abs();
                                    values[comptime!(MOMENTS + channels + 1)] += (hv * ellipse.inverse_v).abs();
                                }
                            }
                        }
                        let stores = own_layer < here;
                        store_sums::<A>(&values, &mut partial, sums, row, stores, lane, columns, plane_units, direct);
                        sync_plane();
                    }
                    if comptime!(!direct) {
                        sync_cube();

                        // A unit adds up the rows of a place, in the order of the planes.
                        let in_part = select(
                            count > bucket_start + first_place,
                            min(count - min(count, bucket_start + first_place), part_places),
                            0u32,
                        );
                        let mut cell = unit;
                        while cell < in_part * comptime!(columns as u32) {
                            let in_order = cell / comptime!(columns as u32);
                            let column = cell % comptime!(columns as u32);
                            let mut sum = 0.0f32;
                            #[unroll]
                            for other in 0..comptime!(TILE_PIXELS as u32 / plane_units) {
                                let of_block = comptime!(other * plane_units / BLOCK_PIXELS as u32);
                                let word = words[(bucket * comptime!(BLOCKS as u32) + of_block) as usize];
                                if ((word >> (first_place + in_order)) & 1) != 0 {
                                    let row = comptime!(other * part_places) + in_order;
                                    sum += partial[(row * comptime!(columns as u32) + column) as usize];
                                }
                            }
                            let target = targets[(bucket_start + first_place + in_order) as usize];
                            let count = range.end_row - range.first_row;
                            store_cell::<A>(sum, target, column as usize, rows, sums, count, columns, add);
                            cell += comptime!(TILE_PIXELS as u32);
                        }
                        sync_cube();
                    }
                }
            }
        }
    }
}

/// Stores the sums over the units of a layer of each of the `columns` values in row `row`, or with `direct` adds them to it, if
/// `stores` is set.
///
/// In each step a unit keeps a half of its values, those of its side, and adds the other side's share of them, which it gets in
/// exchange for its share of the other half. A value without a partner is added up on both sides.
#[cube]
fn store_sums<A: FloatCell>(
    values: &Array<f32>,
    to: &mut Shared<[f32]>,
    sums: &[A],
    row: usize,
    stores: bool,
    lane: u32,
    #[comptime] columns: usize,
    #[comptime] plane_units: u32,
    #[comptime] direct: bool,
) {
    let steps = comptime!((plane_units / RUN_PIXELS as u32).trailing_zeros());
    let mut own = Array::<f32>::new(columns);
    #[unroll]
    for column in 0..columns {
        own[column] = values[column];
    }
    // The column of the first value that the unit holds.
    let mut first = 0u32;
    #[unroll]
    for step in 0..steps {
        let live = comptime!(columns.div_ceil(1 << step));
        let distance = comptime!(1u32 << step);
        let upper = (lane & distance) != 0;
        #[unroll]
        for k in 0..comptime!(live / 2) {
            let even = own[2 * k];
            let odd = own[2 * k + 1];
            own[k] = select(upper, odd, even) + plane_shuffle_xor(select(upper, even, odd), distance);
        }
        if comptime!(live % 2 == 1) {
            own[comptime!(live / 2)] = own[comptime!(live - 1)] + plane_shuffle_xor(own[comptime!(live - 1)], distance);
        }
        first |= select(upper, distance, 0u32);
    }
    #[unroll]
    for k in 0..comptime!(columns.div_ceil(1 << steps)) {
        let column = first + comptime!((k << steps) as u32);
        if stores && column < comptime!(columns as u32) {
            let at = row * columns + column as usize;
            if comptime!(direct) {
                A::add(&sums[at], own[k]);
            } else {
                to[at] = own[k];
            }
        }
    }
}
