//! From camera to 8-bit picture.

use glam::{DVec2, DVec3};
use image::RgbImage;
use rayon::prelude::*;

use super::camera::DemoCamera;
use super::light::{LitScene, display};

/// Samples along each side of a pixel. The average over the pixel's square is what a sensor measures.
const SAMPLES: u32 = 3;

/// Photographs the scene, its rows in parallel. The result does not depend on the number of threads.
pub(super) fn render(scene: &LitScene, camera: &DemoCamera) -> RgbImage {
    let (width, height) = (camera.intrinsics.width as u32, camera.intrinsics.height as u32);
    let mut picture = RgbImage::new(width, height);
    let row_bytes = 3 * camera.intrinsics.width;
    picture.par_chunks_exact_mut(row_bytes).zip(0..height).for_each(|(row, y)| {
        for (pixel, x) in row.chunks_exact_mut(3).zip(0..width) {
            pixel.copy_from_slice(&to_bytes(display(pixel_light(scene, camera, x, y))));
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
