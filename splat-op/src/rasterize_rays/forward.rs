//! Forward kernel of `rasterize_rays`: a cube per tile, a unit per pixel.

use cubecl::prelude::*;

use super::layer::{RayFrame, RayInputs, RayPixel};
use super::walk::front_to_back;
use crate::intersect::TILE_PIXELS;
use crate::rasterize::layer::{TilePixel, tile_origin};

/// Writes the planes `[C + 1 (+ 1), H, W]`. `table` is that of the backward pass, which this one does not fill.
#[cube(launch_unchecked)]
pub(super) fn rasterize_rays_forward_kernel(inputs: RayInputs, planes: &mut [f32], table: &mut [u32], view: RayFrame) {
    let tile = CUBE_POS as u32;
    if tile < view.end_tile {
        let unit = UNIT_POS % comptime!(TILE_PIXELS as u32);
        let pixel = TilePixel::of(tile_origin(tile, &view.frame), unit, &view.frame);
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        let ray = RayPixel::of(pixel, &inputs);
        let front = front_to_back(&inputs, first, places, &ray, pixel.inside, table, 0usize, &view, false);
        if pixel.inside {
            let plane = (view.frame.width * view.frame.height) as usize;
            let channels = comptime!(view.shape.features);
            let transmittance = front.transmittance();
            for channel in 0..channels {
                planes[channel * plane + pixel.index] =
                    front.sums[channel] + transmittance * inputs.background[channel];
            }
            planes[channels * plane + pixel.index] = 1.0 - transmittance;
            if comptime!(view.shape.depth) {
                planes[(channels + 1) * plane + pixel.index] = front.depth();
            }
        }
    }
}
