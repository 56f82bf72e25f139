//! The pass over the layers, for devices with plane operations; `backward.rs` has the form for all others.
//!
//! A unit is a pixel throughout. The sums over the pixels of a block go from unit to unit by shuffles, so shared memory holds
//! sums alone, and a cube has as many planes as a tile has blocks.

use cubecl::prelude::*;

use super::backward::{MOMENTS, row_len};
use super::blocks::{BLOCK, BLOCKS, pixel_of};
use super::forward::WORDS;
use super::layer::{
    BUCKET, FOOTPRINT, Four, KernelShape, LayerEllipse, RasterFrame, SEGMENT, TilePixel, colours_of, first_slot, layer,
    tile_origin, transmittance_after_bucket,
};
use super::suffix::plane_of;
use super::trace::TileRun;
use crate::gpu::atomic::FloatCell;
use crate::intersect::TILE_PIXELS;
use crate::intersect::forward::TileLists;

/// Number of layers whose alphas a unit keeps in registers between its way forwards and its way back.
const TOGETHER: usize = 8;

/// Number of values that are added up together: they take one shuffle each.
const VALUES: usize = 16;

/// Sizes of planes that the kernel is written for. A block's pixels are whole planes.
pub(crate) const PLANES: [u32; 2] = [8, 32];

/// Number of sums in shared memory. Planes that add to the rows of Gaussians themselves need none.
const fn partial_len(columns: usize, direct: bool) -> usize {
    if direct { 1 } else { TILE_PIXELS * columns }
}

/// Bytes of shared memory that the kernel takes.
pub(super) const fn shared_bytes(columns: usize, direct: bool) -> usize {
    4 * (SEGMENT * (4 * FOOTPRINT + 4 + 1) + WORDS + partial_len(columns, direct))
}

/// Does what `rasterize_backward_kernel` does, for few channels. A cube of a unit per pixel takes a segment.
///
/// In a bucket, the units of a block pass the layers of the block's word from the last to the first, eight at a time: forwards for
/// `α` and `T`, which stay in registers, then backwards for `∂L/∂α`, whose moments are added up over the plane. Layers before
/// these eight are evaluated once more for their transmittance; few words have more than eight.
///
/// With `direct`, every plane adds its sums to the rows of the Gaussians, and no plane waits for another. Without, the planes of a
/// cube meet after each bucket and add up their sums in a fixed order first: where the order matters, or an addition is dear.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_planes_kernel<A: FloatCell>(
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
    #[comptime] plane_units: u32,
    #[comptime] direct: bool,
) {
    let channels = comptime!(shape.channels());
    let columns = comptime!(row_len(shape, absolute));
    // Places whose sums are in shared memory at a time: a row for each plane and place, 256 rows.
    let part_places = comptime!(if direct { BUCKET as u32 } else { plane_units });
    let mut words = Shared::<[u32]>::new_slice(comptime!(WORDS));
    let mut ellipses = Shared::<[Four]>::new_slice(comptime!(SEGMENT * FOOTPRINT));
    let mut colours = Shared::<[Four]>::new_slice(comptime!(SEGMENT));
    let mut targets = Shared::<[u32]>::new_slice(comptime!(SEGMENT));
    let mut partial = Shared::<[f32]>::new_slice(comptime!(partial_len(columns, direct)));

    let slot = CUBE_POS as u32;
    if slot < slots {
        let unit = UNIT_POS;
        let block = unit / comptime!(BLOCK as u32);
        let plane_index = unit / plane_units;
        let lane = unit % plane_units;
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
            let place = start + unit;
            if unit < comptime!(SEGMENT as u32) && place < places {
                let target = lists.intersection(first + place) - first_row;
                if target < end_row - first_row {
                    for column in 0..columns {
                        rows[target as usize * columns + column] = 0.0f32;
                    }
                }
            }
        }
        if passed {
            let count = min(places - start, comptime!(SEGMENT as u32));
            let buckets = (count + comptime!(BUCKET as u32 - 1)) / comptime!(BUCKET as u32);
            let pixel = TilePixel::of(tile_origin(tile, &frame), pixel_of(unit), &frame);
            let plane = (frame.width * frame.height) as usize;
            // Two units load a Gaussian.
            let i = unit % comptime!(SEGMENT as u32);
            if i < count {
                let intersection = lists.intersection(first + start + i);
                let gaussian = lists.gaussian_of_intersection[intersection as usize];
                if unit < comptime!(SEGMENT as u32) {
                    LayerEllipse::of(projected, gaussian as usize, pixel.top).store(&mut ellipses, i as usize);
                } else {
                    colours[i as usize] = colours_of(projected, features, gaussian as usize, shape);
                    targets[i as usize] = if comptime!(add) { gaussian } else { intersection - first_row };
                }
            }
            if unit < comptime!(WORDS as u32) {
                words[unit as usize] = kept_words[(slot * comptime!(WORDS as u32) + unit) as usize];
            }
            let mut gradient = Array::<f32>::new(channels);
            #[unroll]
            for channel in 0..channels {
                gradient[channel] = 0.0f32;
                if pixel.inside {
                    gradient[channel] = grad[plane_of(channel, shape) * plane + pixel.index];
                }
            }
            let mut behind = suffix_rho[slot as usize * comptime!(TILE_PIXELS) + unit as usize];
            let at_start = kept[slot as usize * comptime!(shape.kept() * TILE_PIXELS) + unit as usize];
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
                let mut through = 1.0f32;
                let mut stopped = 0.0f32;
                while word != 0 {
                    let i = word.trailing_zeros();
                    word &= word - 1;
                    let place = (bucket * comptime!(BUCKET as u32) + i) as usize;
                    let value = LayerEllipse::load(&ellipses, place).alpha(pixel.x, pixel.row, &frame);
                    let (_, next, stops) = layer(value, through, stopped, current, frame.transmittance_min);
                    through = next;
                    stopped = stops;
                    if through < 0.0 {
                        word = 0u32;
                    }
                }
                current = transmittance_after_bucket(current, through, stopped);
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
                            let value = LayerEllipse::load(&ellipses, i as usize).alpha(pixel.x, pixel.row, &frame);
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
                                let value = LayerEllipse::load(&ellipses, place).alpha(pixel.x, pixel.row, &frame);
                                let (alpha, next, stops) =
                                    layer(value, through, stopped, before, frame.transmittance_min);
                                alphas[k] = alpha;
                                weights[k] = alpha * (before * through);
                                through = next;
                                stopped = stops;
                            }
                        }
                        // Two layers at a time: their sums wait for one another's shuffles.
                        #[unroll]
                        for back in 0..comptime!(TOGETHER / 2) {
                            let pair = comptime!(TOGETHER - 2 - 2 * back);
                            if comptime!(pair as u32) < here {
                                let mut values = Array::<f32>::new(comptime!(2 * columns));
                                #[unroll]
                                for side in 0..2usize {
                                    // The second comes first.
                                    let k = comptime!(pair + 1 - side);
                                    let place = (bucket_start + group_places[k]) as usize;
                                    let ellipse = LayerEllipse::load(&ellipses, place);
                                    let all = colours[place];
                                    let mut along = 0.0f32;
                                    #[unroll]
                                    for channel in 0..channels {
                                        along += gradient[channel] * all.extract(channel);
                                    }
                                    let ahead = select(comptime!(k as u32) < here, along - behind, 0.0);
                                    behind += alphas[k] * ahead;
                                    let h = select(alphas[k] < frame.alpha_max, weights[k] * ahead, 0.0);
                                    let (u, below) = ellipse.along_column(pixel.x);
                                    let v = (below + pixel.row) * ellipse.inverse_v;
                                    let hv = h * v;
                                    let at = comptime!(side * columns);
                                    values[at] = h;
                                    values[at + 1] = h * u;
                                    values[at + 2] = hv;
                                    values[at + 3] = h * u * u;
                                    values[at + 4] = hv * u;
                                    values[at + 5] = hv * v;
                                    #[unroll]
                                    for channel in 0..channels {
                                        values[comptime!(at + MOMENTS + channel)] = weights[k] * gradient[channel];
                                    }
                                    if comptime!(absolute) {
                                        let slope = ellipse.inverse_v * ellipse.shear;
                                        values[comptime!(at + MOMENTS + channels)] =
                                            (h * u * ellipse.inverse_u - hv * slope).abs();
                                        values[comptime!(at + MOMENTS + channels + 1)] = (hv * ellipse.inverse_v).abs();
                                    }
                                }
                                let first_row = plane_index * part_places - first_place;
                                let mut rows = (
                                    (first_row + group_places[comptime!(pair + 1)]) as usize,
                                    (first_row + group_places[pair]) as usize,
                                );
                                if comptime!(direct) {
                                    rows = (
                                        targets[(bucket_start + group_places[comptime!(pair + 1)]) as usize] as usize,
                                        targets[(bucket_start + group_places[pair]) as usize] as usize,
                                    );
                                }
                                let both = comptime!(pair as u32 + 1) < here;
                                store_sums::<A>(
                                    &values,
                                    &mut partial,
                                    sums,
                                    rows,
                                    both,
                                    lane,
                                    columns,
                                    plane_units,
                                    direct,
                                );
                            }
                        }
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
                                let of_block = comptime!(other * plane_units / BLOCK as u32);
                                let word = words[(bucket * comptime!(BLOCKS as u32) + of_block) as usize];
                                if ((word >> (first_place + in_order)) & 1) != 0 {
                                    let row = comptime!(other * part_places) + in_order;
                                    sum += partial[(row * comptime!(columns as u32) + column) as usize];
                                }
                            }
                            let target = targets[(bucket_start + first_place + in_order) as usize];
                            let to = target as usize * columns + column as usize;
                            if comptime!(add) {
                                if sum != 0.0 {
                                    A::add(&sums[to], sum);
                                }
                            } else if target < end_row - first_row {
                                rows[to] = sum;
                            }
                            cell += comptime!(TILE_PIXELS as u32);
                        }
                        sync_cube();
                    }
                }
            }
        }
    }
}

/// Stores the sum over the units of a plane of each of the values of two layers, `columns` each, in the rows of the layers, or with
/// `direct` adds it to them; of the second layer alone unless `both` is set.
///
/// Sixteen values go together. In each step a unit keeps a half of its values, those of its side, and adds the other side's share of
/// them, which it gets in exchange for its share of the other half.
#[cube]
fn store_sums<A: FloatCell>(
    values: &Array<f32>,
    to: &mut Shared<[f32]>,
    sums: &[A],
    rows: (usize, usize),
    both: bool,
    lane: u32,
    #[comptime] columns: usize,
    #[comptime] plane_units: u32,
    #[comptime] direct: bool,
) {
    let (first_row, second_row) = rows;
    #[unroll]
    for chunk in 0..comptime!((2 * columns).div_ceil(VALUES)) {
        let len = comptime!((2 * columns - chunk * VALUES).min(VALUES));
        let width = comptime!(len.next_power_of_two());
        let steps = comptime!(plane_units.trailing_zeros());
        let mut own = Array::<f32>::new(width);
        #[unroll]
        for k in 0..width {
            own[k] = 0.0f32;
            if comptime!(k < len) {
                own[k] = values[comptime!(chunk * VALUES + k)];
            }
        }
        // The value that the unit holds at last, or the first of them.
        let mut index = 0u32;
        #[unroll]
        for step in 0..steps {
            let distance = comptime!(plane_units >> (step + 1));
            let live = comptime!(width >> step);
            if comptime!(live >= 2) {
                let upper = (lane & distance) != 0;
                #[unroll]
                for k in 0..comptime!(live / 2) {
                    let even = own[2 * k];
                    let odd = own[2 * k + 1];
                    own[k] = select(upper, odd, even) + plane_shuffle_xor(select(upper, even, odd), distance);
                }
                index |= select(upper, comptime!(1u32 << step), 0u32);
            } else {
                own[0] = own[0] + plane_shuffle_xor(own[0], distance);
            }
        }
        let held = comptime!((width >> steps).max(1));
        let sharers = comptime!((plane_units as usize / width).max(1) as u32);
        #[unroll]
        for k in 0..held {
            let value = index + comptime!(((k << steps) + chunk * VALUES) as u32);
            let sharer = lane % sharers;
            if sharer == 0 && value < comptime!((chunk * VALUES + len) as u32) {
                let second = value >= comptime!(columns as u32);
                let row = select(second, second_row, first_row);
                let at = row * columns + value as usize - select(second, columns, 0usize);
                if second || both {
                    if comptime!(direct) {
                        A::add(&sums[at], own[k]);
                    } else {
                        to[at] = own[k];
                    }
                }
            }
        }
    }
}
