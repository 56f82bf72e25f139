//! From camera to 8-bit picture.

use glam::{DVec2, DVec3};
use image::RgbImage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::DemoOptions;
use super::camera::DemoCamera;
use super::light::{LitScene, display};

/// Samples along each side of a pixel. The average over the pixel's square is what a sensor measures.
const SAMPLES: u32 = 3;

/// What each photograph multiplies its light by, per channel: one, unless exposures differ.
pub(crate) fn gains(options: &DemoOptions) -> Vec<DVec3> {
    // Another stream than those of the cameras and the points.
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    random.set_stream(2);
    let mut gain = || (DemoOptions::EXPOSURE_STOPS * (2.0 * random.random::<f64>() - 1.0)).exp2();
    let mut of_view = || if options.exposure { DVec3::new(gain(), gain(), gain()) } else { DVec3::ONE };
    (0..options.views).map(|_| of_view()).collect()
}

/// Photographs the scene, its rows in parallel, with a gain per channel on its light. The result does not depend on the
/// number of threads.
pub(super) fn render(scene: &LitScene, camera: &DemoCamera, gain: DVec3) -> RgbImage {
    let (width, height) = (camera.intrinsics.width as u32, camera.intrinsics.height as u32);
    let mut picture = RgbImage::new(width, height);
    let row_bytes = 3 * camera.intrinsics.width;
    picture.par_chunks_exact_mut(row_bytes).zip(0..height).for_each(|(row, y)| {
        for (pixel, x) in row.chunks_exact_mut(3).zip(0..width) {
            pixel.copy_from_slice(&to_bytes(display(gain * pixel_light(scene, camera, x, y))));
        }
    });
    picture
}

/// Linear light, averaged over the square of a pixel.
fn pixel_light(scene: &LitScene, camera: &DemoCamera, x: u32, y: u32) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for sample in 0..SAMPLES * SAMPLES {
        let within = DVec2::new(f64::from(sample % SAMPLES), f64::from(sample / SAMPLES)) + 0.5;
        let at_px = DVec2::new(f64::from(x), f64::from(y)) + within / f64::from(SAMPLES);
        sum += scene.along(&camera.ray_through(at_px));
    }
    sum / f64::from(SAMPLES * SAMPLES)
}

/// The nearest 8-bit levels of a display-referred colour.
pub(super) fn to_bytes(colour: DVec3) -> [u8; 3] {
    // Within 0..=255 after the clamp.
    colour.to_array().map(|channel| (255.0 * channel.clamp(0.0, 1.0)).round() as u8)
}
