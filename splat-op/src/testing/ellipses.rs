//! Random packed ellipses, as `intersect` and `rasterize` take them, without a camera in front.

use super::random::Random;
use crate::camera::Intrinsics;
use crate::project::Ellipse;

/// `[count, 7]` in and around a picture: round and thin ones, from below a pixel to most of the picture, a tenth of them
/// culled. The values are f32's.
pub fn ellipses(seed: u64, count: usize, camera: &Intrinsics, opacity: [f64; 2]) -> Vec<f64> {
    let (width, height) = (camera.width as f64, camera.height as f64);
    // Many are small, so that there are about as many layers however many there are.
    let largest = (0.4 * width.max(height)).min(4.0 * width.max(height) / (count as f64).sqrt()).max(1.5);
    let mut random = Random::new(seed);
    let size = |random: &mut Random| 0.55 * (largest / 0.55_f64).powf(random.between(0.0, 1.0));
    let mut packed = Vec::new();
    for i in 0..count {
        let ellipse = Ellipse {
            mean_px: [random.between(-0.1, 1.1) * width, random.between(-0.1, 1.1) * height],
            sigma_u: size(&mut random),
            shear: random.between(-2.0, 2.0),
            sigma_v: size(&mut random),
            depth: random.between(0.5, 20.0),
            opacity: random.between(opacity[0], opacity[1]),
        };
        let culled = Ellipse { sigma_u: 1.0, sigma_v: 1.0, ..Ellipse::default() };
        packed.extend(if i % 10 == 9 { culled } else { ellipse }.to_row());
    }
    packed.iter().map(|&v| f64::from(v as f32)).collect()
}
