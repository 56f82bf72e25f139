//! Backward pass over the layers. None of its kernels divides by the share that a layer lets through.
//!
//! 1. *Suffix* (`suffix.rs`), a cube per tile: computes `ρ = g·R` behind each segment, the part of the colour behind it
//!    that the gradient depends on.
//! 2. *Layers* (this file, `segment.rs` and `backward_block.rs`), a cube per segment, all segments of all tiles at once,
//!    however long a tile's list is: computes the sums of each intersection over the tile's pixels, a row per intersection.
//! 3. *Gather* (`gather.rs`), a unit per Gaussian: turns the rows into gradients of the ellipse and the features.
//!
//! Rows are either added to one row per Gaussian, in whatever order the device takes them, or kept one per intersection
//! and added in the order of the intersections, which gives the same bits in every run.

use cubecl::prelude::*;

use super::MOMENTS;
use super::backward_block::{SEGMENT_UNITS, SIDE, SegmentMemory, add_block, add_channels, pass_pixels, sums_len};
use super::blocks::{BLOCK_PIXELS, BLOCKS, pixel_of};
use super::layer::{BUCKET, KernelShape, RasterFrame, SplatInputs, TilePixel, tile_origin};
use super::segment::{KeptTrace, Segment, SegmentRange, clear_rows};
use super::splat::{Splat, behind_word};
use super::trace::WORDS;
use crate::gpu::atomic::FloatCell;
use crate::intersect::TILE_PIXELS;

/// Number of values in a row: the moments, the channels, those of the splat, and the two sums of absolute values if they are wanted.
pub(crate) const fn row_len<S: Splat>(shape: KernelShape, absolute: bool) -> usize {
    MOMENTS + shape.channels() + S::EXTRA_COLUMNS + if absolute { 2 } else { 0 }
}

/// Computes the rows of each segment's intersections. A cube goes forwards through the segment for the transmittances
/// before its buckets, then backwards bucket by bucket and, within a bucket, block by block.
///
/// At a block, its units are first pixels. They go forwards through the bits of the block's word for `α` and `T`, then
/// backwards for `∂L/∂α`, and leave `h` and the weights `α T` in tables in shared memory. Then the units are places:
/// they read the tables transposed, and each adds up its own row over the pixels. So a pair's exponential is computed
/// once for its gradient and at most once for its transmittance, and sums need neither atomics nor shuffles. Of the channels
/// a unit sums every eighth one of eight places ([`add_channels`]), so that it reads the tables less often.
///
/// Without `add`, the rows of the intersections of `range` are written to `rows`, and segments without any of
/// them are skipped. With `add`, rows are added to `sums`, one row per Gaussian.
#[cube(launch_unchecked)]
pub(super) fn rasterize_backward_kernel<S: Splat, A: FloatCell>(
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
) {
    let sums_len = comptime!(sums_len(shape));
    let columns = comptime!(row_len::<S>(shape, absolute));
    let mut memory = SegmentMemory::new::<S>();
    let slot = CUBE_POS as u32;
    if slot < range.slots {
        let lane = UNIT_POS;
        let segment = Segment::of(slot, &inputs.lists, &trace, &range, add);
        // DirectX wants a barrier between such readings and a branch with barriers.
        sync_cube();
        if comptime!(!add) {
            clear_rows(&segment, &inputs.lists, rows, &range, columns);
        }
        if segment.passed {
            let origin = tile_origin(segment.tile, &frame);
            memory.words[lane as usize] = trace.words[(slot * comptime!(WORDS as u32) + lane) as usize];
            for block in 0..comptime!(BLOCKS as u32) {
                let unit = (block * comptime!(BLOCK_PIXELS as u32) + lane) as usize;
                memory.checkpoints[unit] = trace.kept[slot as usize * comptime!(shape.kept() * TILE_PIXELS) + unit];
                memory.rho[unit] = trace.suffix_rho[slot as usize * comptime!(TILE_PIXELS) + unit];
            }

            // Forwards.
            for bucket in 0..segment.buckets - 1 {
                // Every bucket but the last is full.
                let place = segment.start + bucket * comptime!(BUCKET as u32) + lane;
                let gaussian = inputs.lists.gaussian(segment.first + place) as usize;
                let splat = S::of(&inputs, gaussian, first_row(origin), &frame);
                S::store(&splat, &mut memory.splats, lane as usize);
                sync_cube();
                pass_bucket::<S>(&mut memory, bucket, origin, &inputs, &frame);
                sync_cube();
            }

            // Backwards.
            for back in 0..segment.buckets {
                let bucket = segment.buckets - 1 - back;
                let bucket_start = segment.start + bucket * comptime!(BUCKET as u32);
                let here = min(segment.places - bucket_start, comptime!(BUCKET as u32));
                if lane < here {
                    let intersection = inputs.lists.intersection(segment.first + bucket_start + lane);
                    let gaussian = inputs.lists.gaussian_of_intersection[intersection as usize];
                    let splat = S::of(&inputs, gaussian as usize, first_row(origin), &frame);
                    S::store(&splat, &mut memory.splats, lane as usize);
                    memory.targets[lane as usize] =
                        if comptime!(add) { gaussian } else { intersection - range.first_row };
                    memory.gaussians[lane as usize] = gaussian;
                }
                let mut row = Array::<f32>::new(comptime!(columns + sums_len));
                #[unroll(shape.held())]
                for column in 0..comptime!(columns + sums_len) {
                    row[column] = 0.0f32;
                }
                sync_cube();

                for block in 0..comptime!(BLOCKS as u32) {
                    let word = memory.words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
                    if word != 0 {
                        pass_pixels::<S>(
                            &mut row,
                            &mut memory,
                            word,
                            bucket,
                            block,
                            origin,
                            grad,
                            &inputs,
                            &frame,
                            shape,
                        );
                    }
                    // Outside the branch: DirectX refuses barriers in branches on what was read.
                    sync_cube();

                    if ((word >> lane) & 1) != 0 {
                        add_block::<S>(&mut row, &memory, block, origin, grad, &inputs, &frame, shape, absolute);
                    }
                    sync_cube();
                    add_channels(&mut row, &mut memory, word, columns, sums_len);
                }

                let count = range.end_row - range.first_row;
                store_rows::<A>(&row, &mut memory, here, rows, sums, count, shape, columns, sums_len, add);
                sync_cube();
            }
        }
    }
}

/// Returns the centre of a tile's first row, px.
#[cube]
fn first_row(origin: (u32, u32)) -> f32 {
    let (_, row) = origin;
    f32::cast_from(row) + 0.5
}

/// Computes the transmittances behind a bucket. The units are the pixels of one block after another.
#[cube]
fn pass_bucket<S: Splat>(
    memory: &mut SegmentMemory,
    bucket: u32,
    origin: (u32, u32),
    inputs: &SplatInputs,
    frame: &RasterFrame,
) {
    for block in 0..comptime!(BLOCKS as u32) {
        let unit = block * comptime!(BLOCK_PIXELS as u32) + UNIT_POS;
        let pixel = TilePixel::of(origin, pixel_of(unit), inputs, frame);
        let at = (bucket * comptime!(TILE_PIXELS as u32) + unit) as usize;
        let before = memory.checkpoints[at];
        let mut word = 0u32;
        if before >= 0.0 {
            word = memory.words[(bucket * comptime!(BLOCKS as u32) + block) as usize];
        }
        memory.checkpoints[at + comptime!(TILE_PIXELS)] =
            behind_word::<S>(&memory.splats, 0, word, before, &pixel, inputs, frame);
    }
}

/// Writes or adds the rows of a bucket. A unit holds the row of a place and, behind it, `len` sums of [`add_channels`].
#[cube]
fn store_rows<A: FloatCell>(
    row: &Array<f32>,
    memory: &mut SegmentMemory,
    here: u32,
    rows: &mut [f32],
    sums: &[A],
    count: u32,
    #[comptime] shape: KernelShape,
    #[comptime] columns: usize,
    #[comptime] len: usize,
    #[comptime] add: bool,
) {
    let lane = UNIT_POS;
    let wide = comptime!(usize::min(len, SEGMENT_UNITS) / SIDE);
    let channels = comptime!(shape.channels());
    #[unroll(shape.held())]
    for t in 0..len {
        let place = lane - lane % comptime!(SIDE as u32) + (t % comptime!(SEGMENT_UNITS) / wide) as u32;
        let channel = t - t % comptime!(SEGMENT_UNITS) + t % wide * SIDE + lane as usize % SIDE;
        if place < here && channel < channels {
            let (target, column) = (memory.targets[place as usize], comptime!(MOMENTS) + channel);
            store_cell::<A>(row[columns + t], target, column, rows, sums, count, columns, add);
        }
    }
    if lane < here {
        #[unroll]
        for k in 0..comptime!(columns - channels) {
            let column = comptime!(if k < MOMENTS { k } else { k + channels });
            let target = memory.targets[lane as usize];
            store_cell::<A>(row[column], target, column, rows, sums, count, columns, add);
        }
    }
}

/// Writes one sum to row `target` of `count`, or adds it.
#[cube]
pub(super) fn store_cell<A: FloatCell>(
    sum: f32,
    target: u32,
    column: usize,
    rows: &mut [f32],
    sums: &[A],
    count: u32,
    #[comptime] columns: usize,
    #[comptime] add: bool,
) {
    let cell = target as usize * columns + column;
    if comptime!(add) {
        if sum != 0.0 {
            A::add(&sums[cell], sum);
        }
    } else if target < count {
        rows[cell] = sum;
    }
}
