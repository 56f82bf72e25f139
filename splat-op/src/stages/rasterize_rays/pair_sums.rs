//! Sums of a Gaussian along rays over the pixels of a block.

use cubecl::prelude::*;

use super::layer::{RayGaussian, RayLayer};
use crate::rasterize::MOMENTS;
use crate::rasterize::layer::KernelShape;
use crate::ray_space::SLOPES;

/// Number of sums of an intersection, besides one per feature.
const SUMS: usize = MOMENTS + SLOPES + 2;

/// The moments, the gradients of the depth slope, the thickness and the centre's relative depth, and the sums of absolute values.
#[derive(CubeType)]
pub(super) struct RaySums {
    sums: Array<f32>,
}

#[cube]
impl RaySums {
    pub fn new() -> RaySums {
        let mut sums = Array::<f32>::new(comptime!(SUMS));
        #[unroll]
        for column in 0..comptime!(SUMS) {
            sums[column] = 0.0f32;
        }
        RaySums { sums }
    }

    /// Adds a pixel, from `h = α ∂L/∂α` and the weight times the gradient of depth, `seen`.
    pub fn add(
        &mut self,
        footprint: &RayGaussian,
        layer: &RayLayer,
        h: f32,
        seen: f32,
        #[comptime] depth: bool,
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
        if comptime!(depth) {
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

    /// Adds the sums to a row.
    pub fn add_to(&self, row: &mut Array<f32>, #[comptime] shape: KernelShape, #[comptime] absolute: bool) {
        #[unroll]
        for column in 0..comptime!(MOMENTS) {
            row[column] += self.sums[column];
        }
        #[unroll]
        for k in 0..comptime!(SLOPES + if absolute { 2 } else { 0 }) {
            row[comptime!(MOMENTS + shape.channels() + k)] += self.sums[comptime!(MOMENTS + k)];
        }
    }
}
