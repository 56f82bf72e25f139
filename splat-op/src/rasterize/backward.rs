//! Backward kernels of `rasterize` before and after the kernel over the layers. None divides by the share that a layer
//! lets through.
//!
//! 1. *Suffix*, a cube per tile, a unit per pixel: computes `ρ = g·R` behind each bucket, the part of the colour behind
//!    it that the gradient depends on, from the last bucket to the first:
//!    `ρ = g·(sums of the bucket) + (share it lets through) ρ`.
//! 2. *Layers*, a cube per bucket, all buckets of all tiles at once, however long a tile's list is: computes the sums
//!    of each intersection over the tile's pixels, a row per intersection. It lies in `backward_few_channels.rs` for
//!    few channels and in `backward_many_channels.rs` for many.
//! 3. *Gather*, a unit per Gaussian: turns the rows into gradients of the ellipse and the features.
//!
//! Rows are either added to one row per Gaussian, in whatever order the device takes them, or kept one per intersection
//! and added in the order of the intersections, which gives the same bits in every run.

use cubecl::prelude::*;

use super::layer::{
    BUCKET, KernelShape, LayerEllipse, RasterFrame, TilePixel, colour, first_bucket, layer, tile_origin,
};
use crate::gpu::reduce::cube_sum;
use crate::intersect::TILE_PIXELS;
use crate::intersect::forward::TileLists;
use crate::project::COLUMNS;

/// Number of moments: the sums of `h, h u, h v, h u², h u v, h v²` with `h = α ∂L/∂α` where alpha is not at its limit.
/// In a row the channels follow, then the two sums of absolute values if they are wanted.
pub(crate) const MOMENTS: usize = 6;

/// Number of values in a row.
pub(crate) const fn row_len(shape: KernelShape, absolute: bool) -> usize {
    MOMENTS + shape.channels() + if absolute { 2 } else { 0 }
}

/// Returns the plane of the picture that holds channel `channel`: alpha lies before depth.
#[cube]
pub(super) fn plane_of(channel: usize, #[comptime] shape: KernelShape) -> usize {
    let mut plane = channel;
    if comptime!(shape.depth) && channel == comptime!(shape.features) {
        plane = channel + 1;
    }
    plane
}

/// Writes `ρ` behind each bucket, `[bucket_index][pixel]`, and the tile's share of the background's gradient, `[tile][feature]`.
#[cube(launch_unchecked)]
pub(super) fn rasterize_suffix_kernel(
    projected: &[f32],
    features: &[f32],
    background: &[f32],
    grad: &[f32],
    lists: TileLists,
    kept: &[f32],
    final_transmittance: &[f32],
    bucket_count: &[u32],
    suffix_rho: &mut [f32],
    mut grad_background: ComptimeOption<Box<[f32]>>,
    frame: RasterFrame,
    #[comptime] shape: KernelShape,
    #[comptime] planes: bool,
) {
    let channels = comptime!(shape.channels());
    let few = comptime!(shape.few());
    let numbers = comptime!(shape.kept());
    let tile = CUBE_POS as u32;
    let unit = UNIT_POS;
    let mut shared = Shared::<[f32]>::new_slice(comptime!(TILE_PIXELS));
    if tile < frame.tiles_x * frame.tiles_y {
        let pixel = TilePixel::of(tile_origin(tile, &frame), unit, &frame);
        let plane = (frame.width * frame.height) as usize;
        let first = lists.start(tile);
        let places = lists.start(tile + 1) - first;
        let bucket_index = first_bucket(first, tile);

        let mut own = Array::<f32>::new(channels);
        let mut grad_alpha = 0.0f32;
        let mut rho = 0.0f32;
        #[unroll(few)]
        for channel in 0..channels {
            own[channel] = 0.0f32;
            if pixel.inside {
                own[channel] = grad[plane_of(channel, shape) * plane + pixel.index];
            }
        }
        if comptime!(shape.grad_alpha) && pixel.inside {
            grad_alpha = grad[comptime!(shape.features) * plane + pixel.index];
        }
        #[unroll(few)]
        for channel in 0..comptime!(shape.features) {
            rho += own[channel] * background[channel];
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_background {
            let last = final_transmittance[tile as usize * comptime!(TILE_PIXELS) + unit as usize];
            for channel in 0..comptime!(shape.features) {
                let sum = cube_sum(own[channel] * last, &mut shared, planes);
                if unit == 0 {
                    out[tile as usize * comptime!(shape.features) + channel] = sum;
                }
            }
        }

        let buckets = bucket_count[tile as usize];
        for step in 0..buckets {
            let bucket = buckets - 1 - step;
            let at = (bucket_index + bucket) as usize * comptime!(numbers * TILE_PIXELS) + unit as usize;
            suffix_rho[(bucket_index + bucket) as usize * comptime!(TILE_PIXELS) + unit as usize] = rho;
            if kept[at] >= 0.0 {
                let through = kept[at + comptime!(TILE_PIXELS)];
                // Alpha is one more channel, of colour one: its sum is the share that the bucket does not let through.
                let mut seen = grad_alpha * (1.0 - through);
                if comptime!(few) {
                    #[unroll]
                    for channel in 0..channels {
                        seen += own[channel] * kept[at + (channel + 2) * comptime!(TILE_PIXELS)];
                    }
                } else {
                    seen = 0.0f32;
                    let mut relative = 1.0f32;
                    let mut stopped = 0.0f32;
                    let end = min((bucket + 1) * comptime!(BUCKET as u32), places);
                    let mut place = bucket * comptime!(BUCKET as u32);
                    let mut open = true;
                    while place < end && open {
                        let gaussian = lists.gaussian(first + place) as usize;
                        let footprint = LayerEllipse::of(projected, gaussian);
                        let (u, v) = footprint.whiten(pixel.x, pixel.top, pixel.row);
                        let alpha = footprint.alpha(u, v, &frame, shape);
                        let (alpha, next, stops) = layer(alpha, relative, stopped, kept[at], frame.transmittance_min);
                        if alpha > 0.0 {
                            let mut along = grad_alpha;
                            for channel in 0..channels {
                                along += own[channel] * colour(projected, features, gaussian, channel, shape);
                            }
                            seen += alpha * relative * along;
                        }
                        open = next >= 0.0;
                        relative = next;
                        stopped = stops;
                        place += 1;
                    }
                }
                rho = seen + through * rho;
            }
        }
    }
}

/// Returns the last of the tiles `first..end` that begins at or before `index`: the tile whose list holds a place, or,
/// if `buckets` is set, whose buckets hold a slot.
#[cube]
pub(crate) fn tile_of(lists: &TileLists, first: u32, end: u32, index: u32, #[comptime] buckets: bool) -> u32 {
    let mut low = first;
    let mut high = end;
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        let start = lists.start(middle);
        let start = if comptime!(buckets) { first_bucket(start, middle) } else { start };
        if start <= index {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// Turns rows into gradients. With `e = −(u² + v²)/2`: `∂e/∂sigma_u = u²/sigma_u`, `∂e/∂sigma_v = v²/sigma_v`,
/// `∂e/∂shear = u v sigma_u/sigma_v`, `∂e/∂mean = (u/sigma_u − v shear/sigma_v, v/sigma_v)`; and
/// `∂α/∂opacity = α/opacity`.
///
/// A row has the moments, the channels, with rays the gradient of the depth slope, and in the last two columns the
/// sums of absolute values, if they are wanted. Gradients of Gaussians without intersections are not written: the
/// buffers must hold zeros.
#[cube(launch_unchecked)]
pub(super) fn rasterize_gather_kernel(
    projected: &[f32],
    order: &[u32],
    first_intersection: &[u32],
    rows: &[f32],
    mut grad_projected: ComptimeOption<Box<[f32]>>,
    mut grad_features: ComptimeOption<Box<[f32]>>,
    mut grad_absolute: ComptimeOption<Box<[f32]>>,
    mut grad_depth_slopes: ComptimeOption<Box<[f32]>>,
    visible: u32,
    intersections: u32,
    #[comptime] shape: KernelShape,
    #[comptime] columns: usize,
    #[comptime] slopes: usize,
    #[comptime] per_intersection: bool,
) {
    let few = comptime!(shape.few());
    let rank = ABSOLUTE_POS;
    if rank < visible as usize {
        let gaussian = order[rank] as usize;
        let mut row = Array::<f32>::new(columns);
        if comptime!(per_intersection) {
            let first = first_intersection[rank];
            let mut end = intersections;
            if rank + 1 < visible as usize {
                end = first_intersection[rank + 1];
            }
            #[unroll(few)]
            for column in 0..columns {
                row[column] = 0.0f32;
            }
            for intersection in first..end {
                #[unroll(few)]
                for column in 0..columns {
                    row[column] += rows[intersection as usize * columns + column];
                }
            }
        } else {
            #[unroll(few)]
            for column in 0..columns {
                row[column] = rows[gaussian * columns + column];
            }
        }
        let at = gaussian * comptime!(COLUMNS);
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_projected {
            let sigma_u = projected[at + 2];
            let shear = projected[at + 3];
            let sigma_v = projected[at + 4];
            let per_v = row[2] / sigma_v;
            out[at] = row[1] / sigma_u - shear * per_v;
            out[at + 1] = per_v;
            out[at + 2] = row[3] / sigma_u;
            out[at + 3] = row[4] * (sigma_u / sigma_v);
            out[at + 4] = row[5] / sigma_v;
            if comptime!(shape.depth) {
                out[at + 5] = row[comptime!(MOMENTS + shape.features)];
            }
            out[at + 6] = row[0] / projected[at + 6];
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_features {
            #[unroll(few)]
            for channel in 0..comptime!(shape.features) {
                out[gaussian * comptime!(shape.features) + channel] = row[comptime!(MOMENTS) + channel];
            }
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_absolute {
            out[2 * gaussian] = row[comptime!(columns - 2)];
            out[2 * gaussian + 1] = row[comptime!(columns - 1)];
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_depth_slopes {
            #[unroll]
            for k in 0..slopes {
                out[gaussian * slopes + k] = row[comptime!(MOMENTS + shape.channels() + k)];
            }
        }
    }
}
