//! Random packed ellipses for `intersect` and `rasterize`, without a projection.

#[cfg(feature = "cube")]
use super::random::Random;
use crate::camera::Intrinsics;
use crate::project::COLUMNS;
#[cfg(feature = "cube")]
use crate::project::Ellipse;
use crate::ray_space::{DEPTH_SLOPE, beyond};

/// `[count, 7]` ellipses in and around a picture, round and thin, from below a pixel to most of the picture; a tenth are culled.
/// The values are exact in f32.
#[cfg(feature = "cube")]
pub fn ellipses(seed: u64, count: usize, camera: &Intrinsics, opacity: [f64; 2]) -> Vec<f64> {
    let (width, height) = (camera.width as f64, camera.height as f64);
    // Sizes shrink with the count, so that the number of layers hardly depends on it.
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

/// Returns rows of `ray_space` for a pinhole, `[N, 9]`, from packed ellipses and from depth slopes and thicknesses, `[N, 3]`.
pub fn ray_rows(packed: &[f64], slopes: &[f64], camera: &Intrinsics) -> Vec<f64> {
    let rows = packed.chunks_exact(COLUMNS).zip(slopes.chunks_exact(DEPTH_SLOPE));
    let row = |(packed, slopes): (&[f64], &[f64])| {
        let away = beyond([packed[0], packed[1]], camera).1;
        [slopes[0], slopes[1], slopes[2], 1.0, away[0], away[1], packed[2], packed[3], packed[4]]
    };
    rows.flat_map(row).collect()
}
