//! Sums of a Gaussian along rays over the pixels of a block.

use cubecl::prelude::*;

use crate::rasterize::MOMENTS;
use crate::rasterize::layer::KernelShape;
use crate::ray_space::SLOPES;

/// Number of sums of an intersection, besides one per feature.
const SUMS: usize = MOMENTS + SLOPES + 2;

/// The moments, the gradients of the depth slope, the thickness and the centre's relative depth, and the sums of absolute values.
#[derive(CubeType)]
pub(super) struct RaySums {
    pub sums: Array<f32>,
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
