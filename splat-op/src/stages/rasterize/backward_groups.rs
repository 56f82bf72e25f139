//! The pass over the layers, for few channels whose sums are added; `backward.rs` has the form for all others.
//!
//! The layers of a group are summed from a table ([`super::groups`]). Where planes exchange values and wait, a plane has a table, a sum
//! over 32 pixels takes eight additions and two shuffles, and no plane waits for another. Elsewhere a block of 32 pixels has one: its
//! units sum runs of four pixels, leave what they sum in the table, and then add up eight such sums each, while the cube waits. So 32
//! units take a ninth of the shared memory of `rasterize_backward_kernel`, and none is idle because its place shows in no pixel of the block.

use cubecl::prelude::*;

use super::backward::row_len;
use super::blocks::{BLOCK_PIXELS, BLOCKS, pixel_of};
use super::ellipse::LayerEllipse;
use super::groups::{GroupMemory, Run, Sharing, load_pixel, load_places, pass_group, pass_layer, sum_run};
use super::layer::{BUCKET, KernelShape, RasterFrame, SplatInputs, TilePixel, tile_origin};
use super::segment::{KeptTrace, Segment, SegmentRange};
use super::splat::behind_word;
use crate::gpu::atomic::FloatCell;
use crate::gpu::reduce::wait;
use crate::intersect::TILE_PIXELS;

/// Sizes of planes that the kernel is written for. A block's pixels are whole planes.
pub(crate) const PLANES: [u32; 2] = [8, 32];

/// Does what `rasterize_backward_kernel` does with `add`, for few channels. A cube of a unit per pixel takes a segment. Every plane or block
/// adds its sums to the rows of the Gaussians. `_rows` is an argument of both kernels, so that they are launched alike.
///
/// In a bucket, the units of a block pass the layers of the block's word from the last to the first, a group at a time: forwards for
/// `α` and `T`, which stay in registers, then backwards for `∂L/∂α`. The transmittance before a group takes one more evaluation of the
/// layers before it: planes evaluate them at each group, blocks once for all groups. Blocks with fewer groups than others wait.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_groups_kernel<A: FloatCell>(
    inputs: SplatInputs,
    grad: &[f32],
    trace: KeptTrace,
    _rows: &mut [f32],
    sums: &[A],
    frame: RasterFrame,
    range: SegmentRange,
    #[comptime] shape: KernelShape,
    #[comptime] absolute: bool,
    #[comptime] sharing: Sharing,
) {
    let columns = comptime!(row_len::<LayerEllipse>(shape, absolute));
    let planes = comptime!(sharing.planes);
    let together = comptime!(sharing.together as u32);
    let units = comptime!(sharing.units as u32);
    let mut memory = GroupMemory::new(shape, sharing);

    let slot = CUBE_POS as u32;
    if slot < range.slots {
        let unit = UNIT_POS;
        let block = unit / comptime!(BLOCK_PIXELS as u32);
        let sharer = unit / units;
        let segment = Segment::of(slot, &inputs.lists, &trace, &range, true);
        // DirectX wants a barrier between such readings and a branch with barriers.
        sync_cube();
        if segment.passed {
            let buckets = segment.buckets;
            let origin = tile_origin(segment.tile, &frame);
            let pixel = TilePixel::of(origin, pixel_of(unit), &inputs, &frame);
            let run = Run::of_unit(origin, &inputs, &frame, sharing);
            if comptime!(planes) {
                load_places(&mut memory, 0u32, &segment, &inputs, pixel.top, &frame, shape, sharing);
            }
            let mut gradient = Array::<f32>::new(comptime!(shape.channels()));
            load_pixel(&mut memory, &mut gradient, slot, &trace.words, grad, &pixel, &frame, shape);
            let mut behind = trace.suffix_rho[slot as usize * comptime!(TILE_PIXELS) + unit as usize];
            let at_start = trace.kept[slot as usize * comptime!(shape.kept() * TILE_PIXELS) + unit as usize];
            sync_cube();

            // Forwards: the transmittances before the buckets.
            let mut before_second = at_start;
            let mut before_third = at_start;
            let mut before_fourth = at_start;
            let mut current = at_start;
            for bucket in 0..buckets - 1 {
                let start = bucket * comptime!(BUCKET as u32);
                if comptime!(!planes) {
                    load_places(&mut memory, start, &segment, &inputs, pixel.top, &frame, shape, sharing);
                    sync_cube();
                }
                let mut word = 0u32;
                if current >= 0.0 {
                    word = memory.words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
                }
                let first = if comptime!(planes) { start } else { 0u32.runtime() };
                current = behind_word::<LayerEllipse>(&memory.ellipses, first, word, current, &pixel, &inputs, &frame);
                before_second = select(bucket == 0, current, before_second);
                before_third = select(bucket == 1, current, before_third);
                before_fourth = select(bucket == 2, current, before_fourth);
                if comptime!(!planes) {
                    sync_cube();
                }
            }

            // Backwards.
            for back in 0..buckets {
                let bucket = buckets - 1 - back;
                let early = select(bucket == 0, at_start, before_second);
                let before = select(bucket < 2, early, select(bucket == 2, before_third, before_fourth));
                let start = bucket * comptime!(BUCKET as u32);
                let first = if comptime!(planes) { start } else { 0u32.runtime() };
                if comptime!(!planes) {
                    load_places(&mut memory, start, &segment, &inputs, pixel.top, &frame, shape, sharing);
                    sync_cube();
                }
                let whole_word = memory.words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
                let layers = whole_word.count_ones();
                let groups = (layers + comptime!(together - 1)) / together;
                let mut turns = if comptime!(sharing.in_step()) { sharing.most_groups().runtime() } else { groups };

                // Before each group: the layers still to pass, and the shares that those before let through and stop.
                let mut left_at = Array::<u32>::new(comptime!(sharing.marks()));
                let mut through_at = Array::<f32>::new(comptime!(sharing.marks()));
                let mut stopped_at = Array::<f32>::new(comptime!(sharing.marks()));
                let mut left = whole_word;
                let mut through = select(before >= 0.0, 1.0f32, -1.0f32);
                let mut stopped = 0.0f32;
                #[unroll]
                for group in 0..comptime!(sharing.marks()) {
                    left_at[group] = left;
                    through_at[group] = through;
                    stopped_at[group] = stopped;
                    if comptime!(!planes) {
                        let others_follow = comptime!(group as u32 + 1) < groups;
                        if others_follow {
                            for _ in 0..together {
                                let i = left.trailing_zeros();
                                left &= left - 1;
                                let (_, next, stops) =
                                    pass_layer(&memory.ellipses, i, through, stopped, before, &pixel, &inputs, &frame);
                                through = next;
                                stopped = stops;
                            }
                        }
                    }
                }
                if comptime!(!planes) {
                    turns = most_groups(&memory, bucket, together);
                }
                for turn in 0..turns {
                    let mut here = 0u32;
                    if comptime!(planes && !sharing.in_step()) || turn < groups {
                        let group = groups - 1 - turn;
                        here = min(layers - group * together, together);
                        let mut left = left_at[0];
                        let mut through = through_at[0];
                        let mut stopped = stopped_at[0];
                        #[unroll]
                        for other in 1..comptime!(sharing.marks()) {
                            let is = group == comptime!(other as u32);
                            left = select(is, left_at[other], left);
                            through = select(is, through_at[other], through);
                            stopped = select(is, stopped_at[other], stopped);
                        }
                        if comptime!(planes) {
                            for _ in 0..group * together {
                                let place = first + left.trailing_zeros();
                                left &= left - 1;
                                let (_, next, stops) = pass_layer(
                                    &memory.ellipses,
                                    place,
                                    through,
                                    stopped,
                                    before,
                                    &pixel,
                                    &inputs,
                                    &frame,
                                );
                                through = next;
                                stopped = stops;
                            }
                        }
                        behind = pass_group(
                            &mut memory,
                            &gradient,
                            first,
                            here,
                            left,
                            through,
                            stopped,
                            before,
                            behind,
                            &pixel,
                            &inputs,
                            &frame,
                            shape,
                            sharing,
                        );
                    }
                    wait(planes);
                    let mut values = Array::<f32>::new(columns);
                    #[unroll]
                    for column in 0..columns {
                        values[column] = 0.0f32;
                    }
                    let mut row = 0usize;
                    let stores = run.layer < here;
                    if stores {
                        let place = (first + memory.group[(sharer * together + run.layer) as usize]) as usize;
                        row = memory.targets[place] as usize;
                        sum_run(&mut values, &memory, &run, place, &inputs, shape, sharing, absolute);
                    }
                    if comptime!(planes) {
                        let lane = unit % units;
                        store_sums::<A>(&values, sums, row, stores, lane, columns, units);
                    } else {
                        // The sums take the place of the layers, which the cube has to have read.
                        sync_cube();
                        add_sums::<A>(&values, &mut memory, sums, here, columns, sharing);
                    }
                    wait(planes);
                }
            }
        }
    }
}

/// Adds the sums over the units of a plane that have one layer to the `columns` values of row `row`, if `stores` is set.
///
/// In each step a unit keeps a half of its values, those of its side, and adds the other side's share of them, which it gets in
/// exchange for its share of the other half. A value without a partner is added up on both sides.
#[cube]
fn store_sums<A: FloatCell>(
    values: &Array<f32>,
    sums: &[A],
    row: usize,
    stores: bool,
    lane: u32,
    #[comptime] columns: usize,
    #[comptime] plane_units: u32,
) {
    let steps = comptime!((plane_units / PLANES[0]).trailing_zeros());
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
            A::add(&sums[row * columns + column as usize], own[k]);
        }
    }
}

/// Returns the largest number of groups of a block in a bucket. Waits for the cube.
#[cube]
fn most_groups(memory: &GroupMemory, bucket: u32, #[comptime] together: u32) -> u32 {
    let mut most = Shared::<[u32]>::new_slice(1usize);
    if UNIT_POS == 0 {
        let mut layers = 0u32;
        #[unroll]
        for block in 0..comptime!(BLOCKS as u32) {
            layers = max(layers, memory.words[(bucket * comptime!(BLOCKS as u32) + block) as usize].count_ones());
        }
        most[0] = (layers + comptime!(together - 1)) / together;
    }
    workgroup_uniform_load(&most[0])
}

/// Adds the sums of a block's units over the runs of each of the first `here` layers to the rows of the Gaussians. Waits for the cube.
#[cube]
fn add_sums<A: FloatCell>(
    values: &Array<f32>,
    memory: &mut GroupMemory,
    sums: &[A],
    here: u32,
    #[comptime] columns: usize,
    #[comptime] sharing: Sharing,
) {
    let together = comptime!(sharing.together as u32);
    let lane = UNIT_POS % comptime!(BLOCK_PIXELS as u32);
    let block = (UNIT_POS / comptime!(BLOCK_PIXELS as u32)) as usize;
    let table = block * comptime!(sharing.table);
    #[unroll]
    for column in 0..columns {
        memory.tables[table + comptime!(column * BLOCK_PIXELS) + lane as usize] = values[column];
    }
    sync_cube();
    let layer = lane % together;
    if layer < here {
        let place = memory.group[block * comptime!(sharing.together) + layer as usize] as usize;
        let row = memory.targets[place] as usize * columns;
        let first_unit = (layer * comptime!(sharing.of_layer())) as usize;
        let mut column = (lane / together) as usize;
        while column < columns {
            let from = table + column * comptime!(BLOCK_PIXELS) + first_unit;
            let mut sum = 0.0f32;
            #[unroll]
            for i in 0..comptime!(sharing.of_layer() as usize) {
                // Units that read another column begin with another bank.
                sum += memory.tables[from + (i + column) % comptime!(sharing.of_layer() as usize)];
            }
            if sum != 0.0 {
                A::add(&sums[row + column], sum);
            }
            column += comptime!(BLOCK_PIXELS / sharing.together);
        }
    }
}
