//! Backward kernels of `rasterize_rays`. No pair of a Gaussian and a pixel goes through memory. No float is accumulated by two units, so
//! every run gives the same bits.
//!
//! A tile's list is cut into buckets of 32 places.
//!
//! 1. *Checkpoints*: a cube per tile, a unit per pixel. It goes front to back as in the forward pass and keeps, for each bucket, the
//!    transmittance before it, `ρ = g·R` behind it, and for each block of 32 pixels a word with the places that some pixel needs.
//! 2. *Rows*: a cube per bucket. At each block its units are first pixels, which go through the places of the word forwards for `α` and
//!    `T` and backwards for `h = α ∂L/∂α`, and leave `h` and the weights `α T` in shared memory. Then they are places, and each sums its
//!    own row over the pixels.
//!
//! The gather kernel of `rasterize` adds a Gaussian's rows in the order of its intersections and turns them into gradients.

use cubecl::prelude::*;

use super::layer::{RayFrame, RayGaussian, RayInputs, RayPixel, shared_len};
use super::pair_sums::{PairSums, row_len};
use crate::intersect::TILE_PIXELS;
use crate::intersect::forward::TileLists;
use crate::rasterize::backward::MOMENTS;
use crate::rasterize::blocks::{BLOCK, BLOCKS, pixel_of};
use crate::rasterize::layer::{FEW, TilePixel, add_compensated, tile_origin};
use crate::rasterize::suffix::FAINTEST;

/// Number of places in a bucket, and of units that compute its rows.
pub(super) const BUCKET: usize = 32;
const _: () = assert!(BUCKET == BLOCK);

/// Number of buckets whose Gaussians a tile loads together.
const TOGETHER: usize = 4;

/// Distance of the rows of a table of places and pixels. Neither direction of reading has bank conflicts.
const STRIDE: usize = BLOCK + 1;

/// What is kept of the buckets of a run of tiles.
#[derive(CubeType, CubeLaunch)]
pub(super) struct Buckets {
    /// `[slot, 256]`: the transmittance before the bucket, negative where the pixel is finished.
    pub transmittance: Box<[f32]>,
    /// `[slot, 256]`: `ρ` behind the bucket.
    pub rho: Box<[f32]>,
    /// `[slot, 8]`: a bit for each place that some pixel of the block needs.
    pub words: Box<[u32]>,
}

/// Returns the number of slots of the tiles `first..end`, whose lists hold the places `start..stop`.
pub(super) const fn slots([first, end]: [usize; 2], [start, stop]: [usize; 2]) -> usize {
    stop / BUCKET - start / BUCKET + (end - first)
}

/// Returns the slot of a tile's first bucket, of those of a launch; see [`slots`]. Each begun bucket has one, so no two tiles share one.
#[cube]
fn first_slot(lists: &TileLists, tile: u32, view: &RayFrame) -> u32 {
    let before = lists.start(view.first_tile) / comptime!(BUCKET as u32);
    lists.start(tile) / comptime!(BUCKET as u32) - before + (tile - view.first_tile)
}

/// Returns the tile of the launch to which a slot belongs.
#[cube]
fn tile_of(lists: &TileLists, slot: u32, view: &RayFrame) -> u32 {
    let mut low = view.first_tile;
    let mut high = view.end_tile;
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if first_slot(lists, middle, view) <= slot {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// The gradients of the planes at a pixel.
#[derive(CubeType)]
struct PixelGrad {
    index: usize,
    /// Those of the features, if they are few.
    features: Array<f32>,
    alpha: f32,
    depth: f32,
}

#[cube]
impl PixelGrad {
    /// Reads them; zero outside the picture.
    fn of(grad: &[f32], pixel: TilePixel, view: &RayFrame) -> PixelGrad {
        let plane = (view.frame.width * view.frame.height) as usize;
        let few = comptime!(view.shape.features <= FEW);
        let count = comptime!(if few { view.shape.features } else { 1 });
        let index = select(pixel.inside, pixel.index, 0usize);
        let mut features = Array::<f32>::new(count);
        #[unroll]
        for channel in 0..count {
            features[channel] = select(pixel.inside, grad[channel * plane + index], 0.0);
        }
        let alpha = select(pixel.inside, grad[comptime!(view.shape.features) * plane + index], 0.0);
        let mut depth = 0.0f32;
        if comptime!(view.shape.depth) {
            depth = select(pixel.inside, grad[comptime!(view.shape.features + 1) * plane + index], 0.0);
        }
        PixelGrad { index, features, alpha, depth }
    }

    /// Returns a layer's values along the gradient. Alpha acts as one more channel of colour one.
    fn along(&self, inputs: &RayInputs, grad: &[f32], gaussian: usize, depth: f32, view: &RayFrame) -> f32 {
        let count = comptime!(view.shape.features);
        let mut along = fma(self.depth, depth, self.alpha);
        if comptime!(count <= FEW) {
            #[unroll]
            for channel in 0..count {
                along += self.features[channel] * inputs.features[gaussian * count + channel];
            }
        } else {
            let plane = (view.frame.width * view.frame.height) as usize;
            for channel in 0..count {
                along += grad[channel * plane + self.index] * inputs.features[gaussian * count + channel];
            }
        }
        along
    }
}

/// Fills the buckets, and `left`, `[H W]`, with the transmittances behind all layers.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_checkpoints_kernel(
    inputs: RayInputs,
    grad: &[f32],
    mut buckets: Buckets,
    left: &mut [f32],
    view: RayFrame,
) {
    let mut near = Shared::<[f32]>::new_slice(comptime!(TOGETHER * BUCKET * shared_len(inputs.rays.is_some())));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(TOGETHER * BUCKET));
    let needed = Shared::<[Atomic<u32>]>::new_slice(comptime!(TOGETHER * BLOCKS));
    let anybody = Shared::<[Atomic<u32>]>::new_slice(1usize);
    let tile = view.first_tile + CUBE_POS as u32;
    if tile < view.end_tile {
        let unit = UNIT_POS;
        let pixel = TilePixel::of(tile_origin(tile, &view.frame), pixel_of(unit), &view.frame);
        let ray = RayPixel::of(pixel, &inputs);
        let own = PixelGrad::of(grad, pixel, &view);
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        let slot = first_slot(&inputs.lists, tile, &view);
        let count = (places + comptime!(BUCKET as u32 - 1)) / comptime!(BUCKET as u32);
        let mut transmittance = select(pixel.inside, 1.0f32, -1.0f32);
        let mut passed = 0u32;
        // DirectX wants a barrier between the reading of `places` and a branch with barriers.
        sync_cube();
        let mut running = places > 0;
        while running {
            let start = passed * comptime!(BUCKET as u32);
            if unit < comptime!((TOGETHER * BUCKET) as u32) && start + unit < places {
                let gaussian = inputs.lists.gaussian(first + start + unit);
                RayGaussian::load(&inputs, gaussian as usize, &view).store(&mut near, unit as usize, &inputs);
                gaussians[unit as usize] = gaussian;
            }
            if unit < comptime!((TOGETHER * BLOCKS) as u32) {
                needed[unit as usize].store(0u32);
            }
            if unit == 0 {
                anybody[0].store(0u32);
            }
            sync_cube();

            for k in 0..comptime!(TOGETHER as u32) {
                let bucket = passed + k;
                if bucket < count {
                    let at = (slot + bucket) as usize * comptime!(TILE_PIXELS) + unit as usize;
                    buckets.transmittance[at] = transmittance;
                    let here = min(places - bucket * comptime!(BUCKET as u32), comptime!(BUCKET as u32));
                    let mut added = 0.0f32;
                    let mut shown = 0u32;
                    let mut i = 0u32;
                    while i < here && transmittance >= 0.0 {
                        let place = (k * comptime!(BUCKET as u32) + i) as usize;
                        let layer = RayGaussian::stored(&near, place, &inputs).at(&ray, &view);
                        if layer.alpha > 0.0 {
                            // A layer that finishes a pixel is needed too.
                            shown |= 1u32 << i;
                            let behind = fma(-layer.alpha, transmittance, transmittance);
                            if behind > view.frame.transmittance_min {
                                let along = own.along(&inputs, grad, gaussians[place] as usize, layer.depth, &view);
                                added += layer.alpha * transmittance * along;
                                transmittance = behind;
                            } else {
                                transmittance = -transmittance;
                            }
                        }
                        i += 1;
                    }
                    buckets.rho[at] = added;
                    if shown != 0 {
                        let word = k * comptime!(BLOCKS as u32) + unit / comptime!(BLOCK as u32);
                        needed[word as usize].fetch_or(shown);
                    }
                }
            }
            if transmittance >= 0.0 {
                anybody[0].fetch_or(1u32);
            }
            sync_cube();

            if unit < comptime!((TOGETHER * BLOCKS) as u32) && passed + unit / comptime!(BLOCKS as u32) < count {
                let at = (slot + passed) * comptime!(BLOCKS as u32) + unit;
                buckets.words[at as usize] = needed[unit as usize].load();
            }
            passed = min(passed + comptime!(TOGETHER as u32), count);
            // With barriers before and after the load.
            let others = workgroup_uniform_load_atomic(&anybody[0]);
            running = others != 0 && passed < count;
        }
        // No pixel needs the buckets behind these.
        let mut word = passed * comptime!(BLOCKS as u32) + unit;
        while word < count * comptime!(BLOCKS as u32) {
            buckets.words[(slot * comptime!(BLOCKS as u32) + word) as usize] = 0u32;
            word += comptime!(TILE_PIXELS as u32);
        }

        if pixel.inside {
            let mut behind = transmittance.abs();
            left[pixel.index] = behind;
            let plane = (view.frame.width * view.frame.height) as usize;
            let channels = comptime!(view.shape.features);
            let mut farthest = 0.0f32;
            for channel in 0..channels {
                farthest += grad[channel * plane + pixel.index] * inputs.background[channel];
            }
            // The sums of the buckets are weighted by the whole transmittance, so those behind a bucket are added up from the last. Where
            // nothing is behind, `ρ` is not rounded.
            let last = behind;
            let mut sum = 0.0f32;
            let mut lost = 0.0f32;
            for step in 0..passed {
                let at = (slot + passed - 1 - step) as usize * comptime!(TILE_PIXELS) + unit as usize;
                let added = buckets.rho[at];
                let divisor = max(behind, FAINTEST);
                let rho = fma(farthest, last / divisor, sum / divisor);
                buckets.rho[at] = select(behind > FAINTEST, rho, farthest);
                let (total, lost_total) = add_compensated(sum, lost, added);
                sum = total;
                lost = lost_total;
                behind = buckets.transmittance[at].abs();
            }
        }
    }
}

/// Writes the rows of those of the intersections `first_row..end_row` that a run of tiles has.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_rows_kernel(
    inputs: RayInputs,
    grad: &[f32],
    buckets: Buckets,
    rows: &mut [f32],
    slots: u32,
    first_row: u32,
    end_row: u32,
    view: RayFrame,
    #[comptime] absolute: bool,
) {
    let mut near = Shared::<[f32]>::new_slice(comptime!(BUCKET * shared_len(inputs.rays.is_some())));
    // Alphas, negative at their limit, then `h`; weights; values along the gradient.
    let mut alphas = Shared::<[f32]>::new_slice(comptime!(BUCKET * STRIDE));
    let mut weights = Shared::<[f32]>::new_slice(comptime!(BUCKET * STRIDE));
    let mut alongs = Shared::<[f32]>::new_slice(comptime!(BUCKET * STRIDE));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(BUCKET));
    let slot = CUBE_POS as u32;
    if slot < slots {
        let lane = UNIT_POS;
        let tile = tile_of(&inputs.lists, slot, &view);
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        let start = (slot - first_slot(&inputs.lists, tile, &view)) * comptime!(BUCKET as u32);
        let mut here = 0u32;
        // The last slot of a tile may have no places.
        if start < places {
            let count = min(places - start, comptime!(BUCKET as u32));
            // Intersections ascend along a tile's list.
            let last = inputs.lists.intersection(first + start + count - 1);
            if inputs.lists.intersection(first + start) < end_row && last >= first_row {
                here = count;
            }
        }
        // DirectX wants a barrier between such readings and a branch with barriers.
        sync_cube();
        if here > 0 {
            let origin = tile_origin(tile, &view.frame);
            let plane = (view.frame.width * view.frame.height) as usize;
            let features = comptime!(view.shape.features);
            let mut target = end_row - first_row;
            if lane < here {
                let intersection = inputs.lists.intersection(first + start + lane);
                let gaussian = inputs.lists.gaussian_of_intersection[intersection as usize];
                RayGaussian::load(&inputs, gaussian as usize, &view).store(&mut near, lane as usize, &inputs);
                gaussians[lane as usize] = gaussian;
                target = intersection - first_row;
            }
            let mut sums = PairSums::new();
            let mut of_features = Array::<f32>::new(features);
            for channel in 0..features {
                of_features[channel] = 0.0f32;
            }
            sync_cube();

            for block in 0..comptime!(BLOCKS as u32) {
                let word = buckets.words[(slot * comptime!(BLOCKS as u32) + block) as usize];
                if word != 0 {
                    // The units are pixels.
                    let unit = block * comptime!(BLOCK as u32) + lane;
                    let pixel = TilePixel::of(origin, pixel_of(unit), &view.frame);
                    let ray = RayPixel::of(pixel, &inputs);
                    let own = PixelGrad::of(grad, pixel, &view);
                    let at_unit = slot as usize * comptime!(TILE_PIXELS) + unit as usize;
                    let mut transmittance = buckets.transmittance[at_unit];
                    let mut left = word;
                    while left != 0 {
                        let i = left.trailing_zeros();
                        left &= left - 1;
                        let at = (i * comptime!(STRIDE as u32) + lane) as usize;
                        let mut alpha = 0.0f32;
                        let mut weight = 0.0f32;
                        let mut along = 0.0f32;
                        if transmittance >= 0.0 {
                            let layer = RayGaussian::stored(&near, i as usize, &inputs).at(&ray, &view);
                            let behind = fma(-layer.alpha, transmittance, transmittance);
                            if layer.alpha > 0.0 && behind > view.frame.transmittance_min {
                                alpha = select(layer.free, layer.alpha, -layer.alpha);
                                weight = layer.alpha * transmittance;
                                along = own.along(&inputs, grad, gaussians[i as usize] as usize, layer.depth, &view);
                                transmittance = behind;
                            } else if layer.alpha > 0.0 {
                                transmittance = -transmittance;
                            }
                        }
                        alphas[at] = alpha;
                        weights[at] = weight;
                        alongs[at] = along;
                    }
                    let mut behind = buckets.rho[at_unit];
                    let mut left = word;
                    while left != 0 {
                        let i = 31u32 - left.leading_zeros();
                        left ^= 1u32 << i;
                        let at = (i * comptime!(STRIDE as u32) + lane) as usize;
                        let alpha = alphas[at];
                        let ahead = alongs[at] - behind;
                        // Where alpha is nearly one, the layer hides what is behind together with its rounding.
                        behind = fma(alpha.abs(), alongs[at], (1.0 - alpha.abs()) * behind);
                        alphas[at] = select(alpha > 0.0, weights[at] * ahead, 0.0);
                    }
                }
                // Outside the branch: DirectX refuses barriers in branches on what was read.
                sync_cube();

                // The units are places.
                if ((word >> lane) & 1) != 0 {
                    let footprint = RayGaussian::stored(&near, lane as usize, &inputs);
                    for other in 0..comptime!(BLOCK as u32) {
                        let at = (lane * comptime!(STRIDE as u32) + other) as usize;
                        let weight = weights[at];
                        if weight > 0.0 {
                            let unit = block * comptime!(BLOCK as u32) + other;
                            let pixel = TilePixel::of(origin, pixel_of(unit), &view.frame);
                            let layer = footprint.at(&RayPixel::of(pixel, &inputs), &view);
                            let mut of_depth = 0.0f32;
                            if comptime!(view.shape.depth) {
                                of_depth = weight * grad[comptime!(features + 1) * plane + pixel.index];
                            }
                            sums.add(&footprint, &layer, alphas[at], of_depth, &view, absolute);
                            for channel in 0..features {
                                of_features[channel] += weight * grad[channel * plane + pixel.index];
                            }
                        }
                    }
                }
                sync_cube();
            }

            if target < end_row - first_row {
                sums.write(rows, target, &view, absolute);
                let at = target as usize * comptime!(row_len(view.shape, absolute)) + comptime!(MOMENTS);
                for channel in 0..features {
                    rows[at + channel] = of_features[channel];
                }
            }
        }
    }
}
