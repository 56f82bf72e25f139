//! Forward kernel of `rasterize`: a cube per tile, a unit per strip of pixels. A strip is some rows of one column, and
//! its values stay in registers. A GPU has units to fill, and hides the latency of reads behind them.
//!
//! The places of a tile are passed in buckets. Within a bucket a pixel's sums and transmittance are relative to those
//! before it; at the end of the bucket they are added in. The backward pass then needs only a few values per pixel of a
//! bucket, which do not depend on any other bucket, so it can process all buckets at once.

use cubecl::prelude::*;

use super::layer::{
    BUCKET, FOOTPRINT, KernelShape, LayerEllipse, RasterFrame, colour, first_bucket, layer, strip_origin,
    transmittance_after_bucket,
};
use crate::intersect::forward::TileLists;
use crate::intersect::{TILE, TILE_PIXELS};

/// Number of places that a cube loads at once, a whole number of buckets.
const BATCH: usize = 64;

/// Writes the planes `[C + 1 (+ 1), H, W]`. If a trace is kept, it also writes the kept values
/// `[bucket_index][value][pixel]`, the transmittance behind all layers `[tile][pixel]`, and the number of buckets
/// passed in each tile.
///
/// The transmittance of a finished pixel is negated. A pixel outside the picture is finished from the start.
#[cube(launch_unchecked)]
pub(super) fn rasterize_forward_kernel(
    projected: &[f32],
    features: &[f32],
    background: &[f32],
    lists: TileLists,
    planes: &mut [f32],
    kept: &mut [f32],
    final_transmittance: &mut [f32],
    bucket_count: &mut [u32],
    frame: RasterFrame,
    #[comptime] shape: KernelShape,
    #[comptime] keep: bool,
    #[comptime] pixels: usize,
) {
    let channels = comptime!(shape.channels());
    let few = comptime!(shape.few());
    let tile = CUBE_POS as u32;
    let mut footprints = Shared::<[f32]>::new_slice(comptime!(BATCH * FOOTPRINT));
    let mut colours = Shared::<[f32]>::new_slice(comptime!(if few { BATCH * channels } else { 1 }));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(BATCH));
    let mut anybody = Shared::<[u32]>::new_slice(1usize);

    if tile < frame.tiles_x * frame.tiles_y {
        let (column, row) = strip_origin(UNIT_POS, pixels);
        let first_column = tile % frame.tiles_x * comptime!(TILE as u32) + column;
        let first_row = tile / frame.tiles_x * comptime!(TILE as u32) + row;
        let in_tile = (row * comptime!(TILE as u32) + column) as usize;
        let x = f32::cast_from(first_column) + 0.5;
        let top = f32::cast_from(first_row - row) + 0.5;
        let own_row = f32::cast_from(row);
        let first = lists.start(tile);
        let places = lists.start(tile + 1) - first;
        let bucket_index = first_bucket(first, tile);

        let mut transmittance = Array::<f32>::new(pixels);
        let mut through = Array::<f32>::new(pixels);
        let mut stopped = Array::<f32>::new(pixels);
        let mut sums = Array::<f32>::new(comptime!(pixels * channels));
        let mut own = Array::<f32>::new(comptime!(pixels * channels));
        #[unroll]
        for p in 0..pixels {
            let inside = first_column < frame.width && first_row + comptime!(p as u32) < frame.height;
            transmittance[p] = select(inside, 1.0f32, -1.0f32);
            #[unroll(few)]
            for channel in 0..channels {
                sums[comptime!(p * channels) + channel] = 0.0f32;
            }
        }

        let mut place = 0u32;
        let mut running = true;
        while running && place < places {
            // Loads the next batch; the loop ends if no pixel is open.
            let mut open = false;
            #[unroll]
            for p in 0..pixels {
                open = open || transmittance[p] >= 0.0;
            }
            if UNIT_POS == 0 {
                anybody[0] = 0u32;
            }
            sync_cube();
            if open {
                anybody[0] = 1u32;
            }
            let count = min(places - place, comptime!(BATCH as u32));
            let mut i = UNIT_POS;
            while i < count {
                let gaussian = lists.gaussian(first + place + i);
                LayerEllipse::of(projected, gaussian as usize).store(&mut footprints, i as usize);
                gaussians[i as usize] = gaussian;
                if comptime!(few) {
                    #[unroll]
                    for channel in 0..channels {
                        colours[i as usize * channels + channel] =
                            colour(projected, features, gaussian as usize, channel, shape);
                    }
                }
                i += comptime!((TILE_PIXELS / pixels) as u32);
            }
            sync_cube();
            running = anybody[0] != 0;
            if running {
                let mut bucket = 0u32;
                while bucket < count {
                    #[unroll]
                    for p in 0..pixels {
                        through[p] = select(transmittance[p] >= 0.0, 1.0f32, -1.0f32);
                        stopped[p] = 0.0f32;
                        #[unroll(few)]
                        for channel in 0..channels {
                            own[comptime!(p * channels) + channel] = 0.0f32;
                        }
                    }
                    let end = select(open, min(bucket + comptime!(BUCKET as u32), count), bucket);
                    for i in bucket..end {
                        let footprint = LayerEllipse::load(&footprints, i as usize);
                        let mut colour_here = Array::<f32>::new(comptime!(if few { channels } else { 1 }));
                        if comptime!(few) {
                            #[unroll]
                            for channel in 0..channels {
                                colour_here[channel] = colours[i as usize * channels + channel];
                            }
                        }
                        #[unroll]
                        for p in 0..pixels {
                            let (u, below) = footprint.along_column(x, top);
                            let v = (below + (own_row + comptime!(p as f32))) * footprint.inverse_v;
                            let alpha = footprint.alpha(u, v, &frame, shape);
                            let before = through[p];
                            let (alpha, next, stops) =
                                layer(alpha, before, stopped[p], transmittance[p], frame.transmittance_min);
                            through[p] = next;
                            stopped[p] = stops;
                            if comptime!(few) {
                                let weight = alpha * before;
                                #[unroll]
                                for channel in 0..channels {
                                    own[comptime!(p * channels) + channel] += weight * colour_here[channel];
                                }
                            } else if alpha > 0.0 {
                                let weight = alpha * before;
                                let gaussian = gaussians[i as usize] as usize;
                                for channel in 0..channels {
                                    own[comptime!(p * channels) + channel] +=
                                        weight * colour(projected, features, gaussian, channel, shape);
                                }
                            }
                        }
                    }
                    let at = (bucket_index + (place + bucket) / comptime!(BUCKET as u32)) as usize
                        * comptime!(shape.kept() * TILE_PIXELS)
                        + in_tile;
                    #[unroll]
                    for p in 0..pixels {
                        let before = transmittance[p];
                        let share = through[p].abs();
                        if comptime!(keep) {
                            let at = at + comptime!(p * TILE);
                            kept[at] = before;
                            kept[at + comptime!(TILE_PIXELS)] = share;
                            if comptime!(few) {
                                #[unroll]
                                for channel in 0..channels {
                                    kept[at + (channel + 2) * comptime!(TILE_PIXELS)] =
                                        own[comptime!(p * channels) + channel];
                                }
                            }
                        }
                        #[unroll(few)]
                        for channel in 0..channels {
                            sums[comptime!(p * channels) + channel] +=
                                before.abs() * own[comptime!(p * channels) + channel];
                        }
                        // A pixel that finished in this bucket becomes negative here; one that finished earlier stays
                        // negative.
                        transmittance[p] = transmittance_after_bucket(before, through[p], stopped[p]);
                    }
                    bucket += comptime!(BUCKET as u32);
                }
                place += count;
            }
            sync_cube();
        }

        if comptime!(keep) {
            #[unroll]
            for p in 0..pixels {
                final_transmittance[tile as usize * comptime!(TILE_PIXELS) + in_tile + comptime!(p * TILE)] =
                    transmittance[p].abs();
            }
            if UNIT_POS == 0 {
                bucket_count[tile as usize] = (place + comptime!(BUCKET as u32 - 1)) / comptime!(BUCKET as u32);
            }
        }
        let plane = (frame.width * frame.height) as usize;
        #[unroll]
        for p in 0..pixels {
            let row = first_row + comptime!(p as u32);
            if first_column < frame.width && row < frame.height {
                let pixel = (row * frame.width + first_column) as usize;
                let left = transmittance[p].abs();
                #[unroll(few)]
                for channel in 0..comptime!(shape.features) {
                    planes[channel * plane + pixel] =
                        sums[comptime!(p * channels) + channel] + left * background[channel];
                }
                planes[comptime!(shape.features) * plane + pixel] = 1.0 - left;
                if comptime!(shape.depth) {
                    planes[comptime!(shape.features + 1) * plane + pixel] =
                        sums[comptime!(p * channels + shape.features)];
                }
            }
        }
    }
}
