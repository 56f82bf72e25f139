//! Renders shots to 8-bit pictures: photographs and masks.

use glam::{DVec2, DVec3};
use image::{DynamicImage, GrayImage, RgbImage, RgbaImage};
use rayon::prelude::*;

use super::DemoOptions;
use super::light::LitScene;
use super::shot::Shot;

/// Samples along each side of a pixel. The average over the pixel's square is what a sensor measures.
const SAMPLES: usize = 3;

/// Samples per pixel of a blurred photograph, each at its own time of the exposure.
const BLURRED_SAMPLES: usize = 36;

/// A ray's position within a pixel, px from its upper left corner, and its time within the exposure, −½ to ½.
type PixelSample = (DVec2, f64);

/// Photographs the scene, its rows in parallel: RGB, or RGBA (straight) if the shot is transparent. The result does not depend
/// on the number of threads.
pub(super) fn render(scene: &LitScene, shot: &Shot) -> DynamicImage {
    let (width, height) = (shot.camera.intrinsics.width, shot.camera.intrinsics.height);
    let samples = if shot.is_blurred() { blurred_samples() } else { sharp_samples() };
    let channels = if shot.transparent { 4 } else { 3 };
    let mut bytes = vec![0; channels * width * height];
    bytes.par_chunks_exact_mut(channels * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let (light, opacity) = pixel_light(scene, shot, DVec2::new(x as f64, y as f64), &samples);
            let middle_px = DVec2::new(x as f64, y as f64) + 0.5;
            pixel[..3].copy_from_slice(&to_bytes(shot.display(light, middle_px)));
            if let [_, _, _, alpha] = pixel {
                *alpha = (255.0 * opacity).round() as u8;
            }
        }
    });
    let (width, height) = (width as u32, height as u32);
    // There are as many bytes as pixels times channels.
    match shot.transparent {
        true => RgbaImage::from_raw(width, height, bytes).map(DynamicImage::from),
        false => RgbImage::from_raw(width, height, bytes).map(DynamicImage::from),
    }
    .expect("a buffer of the picture's size")
}

/// White where the shot shows the scene. Pixels within [`DemoOptions::MASK_MARGIN_PX`] of a disc are excluded.
pub(super) fn mask(shot: &Shot) -> GrayImage {
    let (width, height) = (shot.camera.intrinsics.width as u32, shot.camera.intrinsics.height as u32);
    GrayImage::from_fn(width, height, |x, y| {
        let middle_px = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let covered = |disc: &super::shot::Disc| {
            disc.middle_px.distance(middle_px) <= disc.radius_px + DemoOptions::MASK_MARGIN_PX
        };
        image::Luma([if shot.discs.iter().any(covered) { 0 } else { u8::MAX }])
    })
}

fn sharp_samples() -> Vec<PixelSample> {
    (0..SAMPLES * SAMPLES).map(|i| (place(i), 0.0)).collect()
}

/// The same positions, each with four times.
fn blurred_samples() -> Vec<PixelSample> {
    const PLACES: usize = SAMPLES * SAMPLES;
    let sample = |i: usize| {
        // Every position has one time in each quarter of the exposure; the times of neighbours lie far apart.
        let time = (i / PLACES) * PLACES + (5 * (i % PLACES)) % PLACES;
        (place(i % PLACES), (time as f64 + 0.5) / BLURRED_SAMPLES as f64 - 0.5)
    };
    (0..BLURRED_SAMPLES).map(sample).collect()
}

fn place(i: usize) -> DVec2 {
    (DVec2::new((i % SAMPLES) as f64, (i / SAMPLES) as f64) + 0.5) / SAMPLES as f64
}

/// Linear light averaged over the opaque part of a pixel's square, and that part's share of the square. Both
/// come from the same rays, so that the pixel is right over any background.
fn pixel_light(scene: &LitScene, shot: &Shot, corner_px: DVec2, samples: &[PixelSample]) -> (DVec3, f64) {
    let (mut sum, mut opaque) = (DVec3::ZERO, 0_usize);
    for &(place, time) in samples {
        let at_px = corner_px + place;
        let light = match shot.disc_at(at_px) {
            Some(disc) => Some(disc.light),
            None => light_along(scene, shot, at_px, time),
        };
        if let Some(light) = light {
            sum += light;
            opaque += 1;
        }
    }
    (sum / opaque.max(1) as f64, opaque as f64 / samples.len() as f64)
}

/// The light of a sample; none where the photograph is transparent.
fn light_along(scene: &LitScene, shot: &Shot, at_px: DVec2, time: f64) -> Option<DVec3> {
    let ray = shot.ray(at_px, time);
    if !shot.transparent {
        return Some(scene.along(&ray));
    }
    let point = scene.scene.hit(&ray)?;
    (!scene.scene.is_surroundings(&point)).then(|| scene.towards(&ray, &point))
}

/// The nearest 8-bit levels of a display-referred colour.
pub(super) fn to_bytes(colour: DVec3) -> [u8; 3] {
    // Within 0..=255 after the clamp.
    colour.to_array().map(|channel| (255.0 * channel.clamp(0.0, 1.0)).round() as u8)
}
