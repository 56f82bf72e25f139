//! Forward kernel of `rasterize_rays`: a cube per tile, a unit per pixel. The kernel is simple rather than fast: every unit reads
//! the Gaussians itself and sums into the output planes.
//!
//! With the per-pixel sort, a unit finds the layers of its pixel [`CHUNK`] at a time: each pass through the tile's list finds the
//! layers next behind the last one. This takes no memory and is exact for a list of any length.

use cubecl::prelude::*;

use super::layer::{CHUNK, RayFrame, RayGaussian, RayPixel, Walk};
use crate::intersect::TILE_PIXELS;

/// Writes the planes `[C + 1 (+ 1), H, W]`.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_forward_kernel(
    projected: &[f32],
    depth_slopes: &[f32],
    features: &[f32],
    background: &[f32],
    tile_start: &[u32],
    intersection_of_place: &[u32],
    gaussian_of_intersection: &[u32],
    planes: &mut [f32],
    view: RayFrame,
) {
    let tile = CUBE_POS as u32;
    let pixel = RayPixel::of(tile, UNIT_POS % comptime!(TILE_PIXELS as u32), &view);
    if tile < view.end_tile && pixel.inside {
        let plane = (view.width * view.height) as usize;
        let channels = view.features as usize;
        let first = tile_start[tile as usize];
        let places = tile_start[tile as usize + 1] - first;
        for channel in 0..channels {
            planes[channel * plane + pixel.index] = 0.0f32;
        }
        let mut depth = 0.0f32;
        let mut transmittance = 1.0f32;
        let mut walk = Walk::new();
        let mut open = true;
        while open {
            let count = walk.advance(
                projected,
                depth_slopes,
                intersection_of_place,
                gaussian_of_intersection,
                first,
                places,
                &pixel,
                &view,
            );
            for i in 0..count {
                if open {
                    let alpha = walk.alphas[i as usize];
                    let behind = fma(-alpha, transmittance, transmittance);
                    open = behind > view.transmittance_min;
                    if open {
                        let gaussian = walk.gaussian(i) as usize;
                        let weight = alpha * transmittance;
                        for channel in 0..channels {
                            planes[channel * plane + pixel.index] += weight * features[gaussian * channels + channel];
                        }
                        if comptime!(view.depth) {
                            let footprint = RayGaussian::load(projected, depth_slopes, gaussian);
                            let layer = footprint.at(pixel.x, pixel.y, &view);
                            depth += weight * footprint.depth_of(&layer, &view);
                        }
                        transmittance = behind;
                    }
                }
            }
            open = open && count == comptime!(CHUNK as u32);
        }
        for channel in 0..channels {
            planes[channel * plane + pixel.index] += transmittance * background[channel];
        }
        planes[channels * plane + pixel.index] = 1.0 - transmittance;
        if comptime!(view.depth) {
            planes[(channels + 1) * plane + pixel.index] = depth;
        }
    }
}
