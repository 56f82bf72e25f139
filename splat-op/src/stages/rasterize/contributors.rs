//! The contributors of each pixel on a GPU: a cube per tile, a unit per pixel.

use cubecl::prelude::*;

use super::blocks::pixel_of;
use super::ellipse::LayerEllipse;
use super::launch::{DeviceSplats, frame};
use super::layer::{
    BUCKET, BUCKETS, Four, RasterFrame, SEGMENT, SplatInputs, TilePixel, add_compensated, layer, lost_after_bucket,
    tile_origin, transmittance_after_bucket,
};
use super::splat::Splat;
use super::{Layers, MEDIAN, RasterizeSpec};
use crate::backend::GpuOutput;
use crate::gpu::{Buffer, Gpu, cubes};
use crate::intersect::TILE_PIXELS;
use crate::intersect::launch::DeviceIntersections;
use crate::rasterize_rays::layer::RayGaussian;

/// An id of minus one, as bits.
const NONE: u32 = u32::MAX;

/// Writes the first `most` contributors of each pixel, front to back, `[H, W, most]`, and the one at which the transmittance falls to
/// [`MEDIAN`], `[H, W]`. The transmittances are those of the forward pass, which leaves out pairs that do not show.
#[cube(launch_unchecked)]
fn contributors_kernel<S: Splat>(
    inputs: SplatInputs,
    ids: &mut [u32],
    weights: &mut [f32],
    medians: &mut [u32],
    frame: RasterFrame,
    tiles: u32,
    most: u32,
) {
    let tile = CUBE_POS as u32;
    let mut splats = Shared::<[Four]>::new_slice(comptime!(SEGMENT * S::VECTORS));
    let mut gaussians = Shared::<[u32]>::new_slice(comptime!(SEGMENT));
    let anybody = Shared::<[Atomic<u32>]>::new_slice(1usize);
    if tile < tiles {
        let unit = UNIT_POS;
        let pixel = TilePixel::of(tile_origin(tile, &frame), pixel_of(unit), &inputs, &frame);
        let first = inputs.lists.start(tile);
        let places = inputs.lists.start(tile + 1) - first;
        // DirectX wants a barrier between such readings and a loop with barriers.
        sync_cube();

        let mut transmittance = 1.0f32;
        let mut lost = 0.0f32;
        let mut found = 0u32;
        let mut median = NONE.runtime();
        let mut open = pixel.inside;
        let mut segment = 0u32;
        let mut running = places > 0;
        while running {
            let here = min(places - segment * comptime!(SEGMENT as u32), comptime!(SEGMENT as u32));
            if unit < here {
                let gaussian = inputs.lists.gaussian(first + segment * comptime!(SEGMENT as u32) + unit);
                let splat = S::of(&inputs, gaussian as usize, pixel.top, &frame);
                S::store(&splat, &mut splats, unit as usize);
                gaussians[unit as usize] = gaussian;
            }
            if unit == 0 {
                anybody[0].store(0u32);
            }
            sync_cube();

            for bucket in 0..comptime!(BUCKETS as u32) {
                let before = transmittance;
                let mut through = 1.0f32;
                let mut stopped = 0.0f32;
                let mut place = bucket * comptime!(BUCKET as u32);
                let end = min(place + comptime!(BUCKET as u32), here);
                while open && place < end {
                    let (value, _) = S::seen(&S::load(&splats, place as usize, &inputs), &pixel, &frame);
                    let (alpha, next, stops) = layer(value, through, stopped, before, frame.transmittance_min);
                    if alpha > 0.0 {
                        let gaussian = gaussians[place as usize];
                        if found < most {
                            let at = pixel.index * most as usize + found as usize;
                            ids[at] = gaussian;
                            weights[at] = alpha * (before * through);
                            found += 1;
                        }
                        let behind = transmittance_after_bucket(before, next, stops);
                        if median == NONE && behind <= comptime!(MEDIAN as f32) {
                            median = gaussian;
                        }
                    }
                    through = next;
                    stopped = stops;
                    open = through >= 0.0 && (found < most || median == NONE);
                    place += 1;
                }
                transmittance = transmittance_after_bucket(before, through, stopped);
                lost = lost_after_bucket(lost, before, transmittance, through, stopped);
            }
            // A pixel that is not open is not passed again.
            let (sum, lost_sum) = add_compensated(transmittance, lost, 0.0f32);
            transmittance = sum;
            lost = lost_sum;
            if open {
                anybody[0].fetch_or(1u32);
            }
            segment += 1;
            let others = workgroup_uniform_load_atomic(&anybody[0]);
            // The next segment resets the cell, and only WGSL has a barrier behind this load.
            sync_cube();
            running = others != 0 && segment * comptime!(SEGMENT as u32) < places;
        }

        if pixel.inside {
            for entry in found..most {
                let at = pixel.index * most as usize + entry as usize;
                ids[at] = NONE;
                weights[at] = 0.0f32;
            }
            medians[pixel.index] = median;
        }
    }
}

/// Returns the ids, the weights and the medians.
pub(super) fn launch_contributors(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    lists: &DeviceIntersections,
    spec: &RasterizeSpec,
    most: usize,
) -> Vec<GpuOutput> {
    let pixels = spec.intrinsics.width * spec.intrinsics.height;
    let [ids, medians] = [pixels * most, pixels].map(|len| Buffer::<u32>::new(gpu, len));
    let (weights, tiles) = (Buffer::<f32>::new(gpu, pixels * most), lists.counts.len);
    let launch = match spec.options.along_rays() {
        true => contributors_kernel::launch_unchecked::<RayGaussian>,
        false => contributors_kernel::launch_unchecked::<LayerEllipse>,
    };
    // SAFETY: places and Gaussians come from the lists, which hold none out of range; pixels are guarded.
    unsafe {
        launch(
            &gpu.client,
            cubes(tiles),
            CubeDim::new_1d(TILE_PIXELS as u32),
            DeviceSplats::new(gpu, inputs, lists, spec).arg(),
            ids.arg(),
            weights.arg(),
            medians.arg(),
            frame(spec),
            tiles as u32,
            most as u32,
        );
    }
    [Some(ids.handle), Some(weights.handle), Some(medians.handle)].into()
}
