//! What tests of the rasterizers share.

#[cfg(feature = "cube")]
use super::launch::DevicePlanes;
use super::prepared::Trace;
#[cfg(feature = "cube")]
use super::trace::DeviceTrace;
use super::{PlaneParts, RasterizeSpec};
#[cfg(feature = "cube")]
use crate::gpu::Gpu;

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
