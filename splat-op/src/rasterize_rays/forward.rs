//! Forward kernel of `rasterize_rays`: a cube per tile, a unit per pixel. The kernel is simple rather than fast: every unit reads
//! the Gaussians itself and sums into the output planes.
//!
//! With the per-pixel sort, a unit finds the layers of its pixel [`CHUNK`] at a time: each pass through the tile's list finds the
//! layers next behind the last one. This takes no memory and is exact for a list of any length.

use cubecl::prelude::*;

use super::layer::{CHUNK, RayFrame, RayGaussian, RayInputs, RayPixel, Walk};
use crate::intersect::TILE_PIXELS;
use crate::rasterize::layer::{TilePixel, tile_origin};

/// Writes the planes `[C + 1 (+ 1), H, W]`.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_forward_kernel(inputs: RayInputs, planes: &mut [f32], view: RayFrame) {
    let tile = CUBE_POS as u32;
    let origin = tile_origin(tile, &view.frame);
    let pixel = TilePixel::of(origin, UNIT_POS % comptime!(TILE_PIXELS as u32), &view.frame);
    if tile < view.end_tile && pixel.inside {
        let plane = (view.frame.width * view.frame.height) as usize;
        let channels = comptime!(view.shape.features);
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        for channel in 0..channels {
            planes[channel * plane + pixel.index] = 0.0f32;
        }
        let ray = RayPixel::of(pixel, &inputs);
        let mut depth = 0.0f32;
        let mut transmittance = 1.0f32;
        let mut walk = Walk::new();
        let mut open = true;
        while open {
            let count = walk.advance(&inputs, first, places, &ray, &view);
            for i in 0..count {
                if open {
                    let alpha = walk.alphas[i as usize];
                    let behind = fma(-alpha, transmittance, transmittance);
                    open = behind > view.frame.transmittance_min;
                    if open {
                        let gaussian = walk.gaussians[i as usize] as usize;
                        let weight = alpha * transmittance;
                        for channel in 0..channels {
                            planes[channel * plane + pixel.index] +=
                                weight * inputs.features[gaussian * channels + channel];
                        }
                        if comptime!(view.shape.depth) {
                            let footprint = RayGaussian::load(&inputs, gaussian, &view);
                            let layer = footprint.at(&ray, &view);
                            depth += weight * footprint.depth_of(&layer, &view);
                        }
                        transmittance = behind;
                    }
                }
            }
            open = open && count == comptime!(CHUNK as u32);
        }
        for channel in 0..channels {
            planes[channel * plane + pixel.index] += transmittance * inputs.background[channel];
        }
        planes[channels * plane + pixel.index] = 1.0 - transmittance;
        if comptime!(view.shape.depth) {
            planes[(channels + 1) * plane + pixel.index] = depth;
        }
    }
}
