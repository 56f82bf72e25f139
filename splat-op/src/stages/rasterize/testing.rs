//! What tests of the rasterizers share.

#[cfg(feature = "cube")]
use super::launch::DevicePlanes;
use super::prepared::Trace;
#[cfg(feature = "cube")]
use super::trace::DeviceTrace;
use super::{PlaneParts, RasterizeSpec};
#[cfg(feature = "cube")]
use crate::gpu::Gpu;
use crate::project::Ellipse;
use crate::testing::random::Random;

impl<'a, F> PlaneParts<&'a [F]> {
    /// Splits the gradient of all planes, `[C + 1 (+ 1), H, W]`, of a render of `features` features.
    pub(crate) fn split(grad: &'a [F], spec: &RasterizeSpec, features: usize) -> Self {
        let pixels = spec.intrinsics.width * spec.intrinsics.height;
        let (colour, rest) = grad.split_at(features * pixels);
        let (alpha, depth) = rest.split_at(pixels);
        Self { colour, alpha, depth }
    }
}

impl<F> Trace<F> {
    /// For each Gaussian of each tile, a bit for each block that the backward pass evaluates.
    pub fn reached(&mut self) -> impl Iterator<Item = &mut u16> {
        let tiles = match self {
            Self::Ellipses(trace) => &mut trace.tiles,
            Self::Rays(trace) => &mut trace.tiles,
        };
        tiles.iter_mut().flat_map(|tile| &mut tile.reached)
    }
}

#[cfg(feature = "cube")]
impl DeviceTrace {
    /// Number of runs.
    pub fn runs(&self) -> usize {
        self.runs.len()
    }
}

#[cfg(feature = "cube")]
impl DevicePlanes {
    pub fn read(&self, gpu: &Gpu) -> Vec<f32> {
        self.parts().flat_map(|part| part.read(gpu)).collect()
    }
}

/// Ellipses near the tile at `corner` px: of ordinary size, or of any size, shape and distance.
pub fn any_ellipse(random: &mut Random, corner: [f64; 2], ordinary: bool, opacity: [f64; 2]) -> Ellipse<f64> {
    let mut logarithmic = |low: f64, high: f64| low * (high / low).powf(random.between(0.0, 1.0));
    let (sigma_u, sigma_v) = match ordinary {
        true => (logarithmic(0.55, 20.0), logarithmic(0.55, 20.0)),
        false => (logarithmic(1e-3, 1e6), logarithmic(1e-3, 1e5)),
    };
    let (steepest, away) = match ordinary {
        true => (2.0, logarithmic(0.1, 3.0) * sigma_u),
        false => (logarithmic(1e-3, 1e4), logarithmic(1e-3, 8.0) * sigma_u),
    };
    let opacity = logarithmic(opacity[0], opacity[1]);
    let shear = random.between(-steepest, steepest);
    // The axis of long ellipses passes through or near the tile.
    let along = if random.between(0.0, 1.0) < 0.5 { away } else { -away };
    let across = random.between(-4.0, 4.0) * sigma_v;
    let place = [0, 1].map(|axis| corner[axis] + random.between(-2.0, 18.0));
    Ellipse {
        mean_px: [place[0] - along, place[1] - shear * along - across],
        sigma_u,
        shear,
        sigma_v,
        depth: 1.0,
        opacity,
    }
}
