//! Sums of an intersection over the pixels of a tile.

use cubecl::prelude::*;

use super::layer::{RayFrame, RayGaussian, RayLayer};
use crate::rasterize::backward::{self, MOMENTS};
use crate::rasterize::layer::KernelShape;
use crate::ray_space::SLOPES;

/// Number of columns of a row: those of `rasterize` and the gradients of the depth slope, the thickness and the centre's relative
/// depth.
pub(super) const fn row_len(shape: KernelShape, absolute: bool) -> usize {
    backward::row_len(shape, absolute) + SLOPES
}

/// Number of sums of an intersection, besides one per feature.
const SUMS: usize = MOMENTS + SLOPES + 2;

/// The moments, the gradients of the depth slope, the thickness and the centre's relative depth, and the sums of absolute values.
#[derive(CubeType)]
pub(super) struct PairSums {
    sums: Array<f32>,
}

#[cube]
impl PairSums {
    pub fn new() -> PairSums {
        let mut sums = Array::<f32>::new(comptime!(SUMS));
        #[unroll]
        for column in 0..comptime!(SUMS) {
            sums[column] = 0.0f32;
        }
        PairSums { sums }
    }

    /// Adds a pixel, from `h = α ∂L/∂α` and the weight times the gradient of depth, `seen`.
    pub fn add(
        &mut self,
        footprint: &RayGaussian,
        layer: &RayLayer,
        h: f32,
        seen: f32,
        view: &RayFrame,
        #[comptime] absolute: bool,
    ) {
        let (u, v) = (layer.u, layer.v);
        let (slope_u, slope_v) = (footprint.depth_slope_u, footprint.depth_slope_v);
        let (a, b, c) = (layer.apart_u, layer.apart_v, layer.apart_s);
        // As `fma`, so that no compiler rounds otherwise where the sums of absolute values read these too.
        let (reach_u, reach_v) = (fma(c, slope_u, a), fma(c, slope_v, b));
        let of_depth = h * c;
        let mut of_gamma = -of_depth;
        let mut of_thickness = c * of_depth;
        // The negative gradients of `α` and `β`.
        let mut centre_u = h * reach_u;
        let mut centre_v = h * reach_v;
        if comptime!(view.shape.depth) {
            let of_lambda = seen * footprint.depth;
            let (far, along_s) = (of_lambda * layer.phi, of_lambda * layer.along);
            of_gamma += along_s;
            of_thickness -= 2.0 * c * along_s;
            centre_u = fma(h, reach_u, fma(far, u, -(along_s * slope_u)));
            centre_v = fma(h, reach_v, fma(far, v, -(along_s * slope_v)));
            self.sums[3] += far * reach_u * u;
            self.sums[4] += far * reach_v * u;
            self.sums[5] += far * reach_v * v;
            self.sums[6] -= far * c * u;
            self.sums[7] -= far * c * v;
        }
        self.sums[6] += of_gamma * a;
        self.sums[7] += of_gamma * b;
        self.sums[8] += footprint.thickness * of_thickness;
        self.sums[9] += of_gamma;
        self.sums[0] += h;
        self.sums[1] += centre_u;
        self.sums[2] += centre_v;
        self.sums[3] += centre_u * a;
        self.sums[4] += centre_v * a;
        self.sums[5] += centre_v * b;
        if comptime!(absolute) {
            let (x, y) = footprint.per_px(centre_u, centre_v);
            self.sums[10] += x.abs();
            self.sums[11] += y.abs();
        }
    }

    /// Writes all but the features of row `row`.
    pub fn write(&self, rows: &mut [f32], row: u32, view: &RayFrame, #[comptime] absolute: bool) {
        let columns = comptime!(row_len(view.shape, absolute));
        let at = row as usize * columns;
        #[unroll]
        for column in 0..comptime!(MOMENTS) {
            rows[at + column] = self.sums[column];
        }
        if comptime!(view.shape.depth) {
            // The gather kernel has a column for it; the depth of a layer has its gradient in the rows of `ray_space`.
            rows[at + comptime!(MOMENTS + view.shape.features)] = 0.0f32;
        }
        let rest = comptime!(MOMENTS + view.shape.channels());
        #[unroll]
        for k in 0..comptime!(columns - rest) {
            rows[at + rest + k] = self.sums[comptime!(MOMENTS + k)];
        }
    }
}
