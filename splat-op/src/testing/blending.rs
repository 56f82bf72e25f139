//! Blending by its definition, shared by the tests of `rasterize` with both splats.

use super::random::Random;
use crate::options::RenderOptions;
use crate::project::Ellipse;
use crate::rasterize::RasterizeSpec;

/// Contribution of a Gaussian to a pixel.
pub struct PixelLayer {
    pub gaussian: usize,
    /// Alpha before its upper limit.
    pub alpha: f64,
    /// Depth, scene units.
    pub depth: f64,
}

/// Planes of features `[N, C]` over a background `[C]`. `layers` returns those of a pixel, front to back.
pub fn blended(
    spec: &RasterizeSpec,
    features: &[f64],
    background: &[f64],
    layers: impl Fn(usize) -> Vec<PixelLayer>,
) -> Vec<f64> {
    let (options, channels) = (&spec.options, background.len());
    let pixels = spec.intrinsics.width * spec.intrinsics.height;
    let mut planes = vec![0.0; spec.planes(channels) * pixels];
    for pixel in 0..pixels {
        let mut transmittance = 1.0;
        for PixelLayer { gaussian, alpha, depth } in layers(pixel) {
            let alpha = alpha.min(options.alpha_max);
            if alpha < options.alpha_min {
                continue;
            }
            let behind = transmittance * (1.0 - alpha);
            if options.transmittance_min > 0.0 && behind <= options.transmittance_min {
                break;
            }
            for channel in 0..channels {
                planes[channel * pixels + pixel] += transmittance * alpha * features[gaussian * channels + channel];
            }
            if options.depth {
                planes[(channels + 1) * pixels + pixel] += transmittance * alpha * depth;
            }
            transmittance = behind;
        }
        for channel in 0..channels {
            planes[channel * pixels + pixel] += transmittance * background[channel];
        }
        planes[channels * pixels + pixel] = 1.0 - transmittance;
    }
    planes
}

/// Ellipses in and around a picture of a few tiles.
pub fn small_ellipse(
    random: &mut Random,
    [width, height]: [usize; 2],
    depth: impl FnOnce(&mut Random) -> f64,
    opacity: [f64; 2],
) -> Ellipse<f64> {
    Ellipse {
        mean_px: [random.between(-3.0, width as f64 + 3.0), random.between(-3.0, height as f64 + 3.0)],
        sigma_u: random.between(0.7, 7.0),
        shear: random.between(-1.5, 1.5),
        sigma_v: random.between(0.7, 5.0),
        depth: depth(random),
        opacity: random.between(opacity[0], opacity[1]),
    }
}

/// Options without thresholds: the derivative exists everywhere except where an alpha equals `alpha_max` and where two layers
/// change places.
pub fn smooth(alpha_max: f64) -> RenderOptions {
    RenderOptions { alpha_min: 0.0, transmittance_min: 0.0, alpha_max, ..RenderOptions::standard() }
}

#[track_caller]
pub fn assert_close(what: &str, found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        let error = (found - expected).abs();
        assert!(error <= tolerance * (1.0 + expected.abs()), "{what}[{i}]: found {found}, expected {expected}");
    }
}
