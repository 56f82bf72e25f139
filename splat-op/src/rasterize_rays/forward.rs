//! Forward kernel of `rasterize_rays`: a cube per tile, a unit per pixel. The units of a tile load [`NEAR`] Gaussians at a time, each
//! once, and evaluate them from shared memory, front to back.

use cubecl::prelude::*;

use super::layer::{RayFrame, RayGaussian, RayInputs, RayPixel, shared_len};
use crate::intersect::TILE_PIXELS;
use crate::rasterize::layer::{TilePixel, tile_origin};

/// Number of Gaussians in shared memory: 9.7 KiB with the columns of a lens.
const NEAR: usize = 128;

/// Writes the planes `[C + 1 (+ 1), H, W]`.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_forward_kernel(inputs: RayInputs, planes: &mut [f32], view: RayFrame) {
    let mut near = Shared::<[f32]>::new_slice(comptime!(NEAR * shared_len(inputs.rays.is_some())));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(NEAR));
    let anybody = Shared::<[Atomic<u32>]>::new_slice(1usize);
    let tile = CUBE_POS as u32;
    if tile < view.end_tile {
        let unit = UNIT_POS % comptime!(TILE_PIXELS as u32);
        let pixel = TilePixel::of(tile_origin(tile, &view.frame), unit, &view.frame);
        let ray = RayPixel::of(pixel, &inputs);
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        let channels = comptime!(view.shape.features);
        let mut sums = Array::<f32>::new(channels);
        for channel in 0..channels {
            sums[channel] = 0.0f32;
        }
        let mut sum_depth = 0.0f32;
        let mut transmittance = 1.0f32;
        // Whether layers may follow: the pixel is in the picture and not finished.
        let mut open = pixel.inside;
        let mut start = 0u32;
        // DirectX wants a barrier between the reading of `places` and a branch with barriers.
        sync_cube();
        let mut passing = places > 0;
        while passing {
            let here = min(places - start, comptime!(NEAR as u32));
            if UNIT_POS < here {
                let gaussian = inputs.lists.gaussian(first + start + UNIT_POS);
                RayGaussian::load(&inputs, gaussian as usize, &view).store(&mut near, UNIT_POS as usize, &inputs);
                gaussians[UNIT_POS as usize] = gaussian;
            }
            if UNIT_POS == 0 {
                anybody[0].store(0u32);
            }
            sync_cube();

            let mut i = 0u32;
            while i < here && open {
                let layer = RayGaussian::stored(&near, i as usize, &inputs).at(&ray, &view);
                if layer.alpha > 0.0 {
                    let behind = fma(-layer.alpha, transmittance, transmittance);
                    open = behind > view.frame.transmittance_min;
                    if open {
                        let weight = layer.alpha * transmittance;
                        let gaussian = gaussians[i as usize] as usize;
                        for channel in 0..channels {
                            sums[channel] += weight * inputs.features[gaussian * channels + channel];
                        }
                        if comptime!(view.shape.depth) {
                            sum_depth += weight * layer.depth;
                        }
                        transmittance = behind;
                    }
                }
                i += 1;
            }
            if open {
                anybody[0].fetch_or(1u32);
            }
            start += here;
            // With barriers before and after the load.
            let others = workgroup_uniform_load_atomic(&anybody[0]);
            passing = others != 0 && start < places;
        }
        if pixel.inside {
            let plane = (view.frame.width * view.frame.height) as usize;
            for channel in 0..channels {
                planes[channel * plane + pixel.index] = sums[channel] + transmittance * inputs.background[channel];
            }
            planes[channels * plane + pixel.index] = 1.0 - transmittance;
            if comptime!(view.shape.depth) {
                planes[(channels + 1) * plane + pixel.index] = sum_depth;
            }
        }
    }
}
