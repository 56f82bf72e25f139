//! The order of Gaussians in memory: neighbours in space are neighbours in memory, so that the Gaussians of one tile are
//! close together.

use glam::Vec3;
use rayon::prelude::*;

/// The order of `means`, world frame, along the Z-order curve (Morton 1966) through the bounding box of all finite rows.
/// Non-finite rows come last. Rows of one cell keep their order.
pub fn morton_order(means: &[[f32; 3]]) -> Vec<u32> {
    let points = || means.iter().map(|mean| Vec3::from(*mean)).filter(|mean| mean.is_finite());
    let low = points().fold(Vec3::INFINITY, Vec3::min).as_dvec3();
    let high = points().fold(Vec3::NEG_INFINITY, Vec3::max).as_dvec3();
    // A cube, so that cells have equal sides. In f64, because the bounding box of finite f32 numbers may be larger than the
    // largest f32.
    let side = (high - low).max_element();
    let per_unit = if side > 0.0 { f64::from(u32::MAX) / side } else { 0.0 };
    let key = |mean: &[f32; 3]| {
        let mean = Vec3::from(*mean);
        // Casts saturate. A key of three 32-bit coordinates has 96 bits.
        mean.is_finite().then(|| zorder::index_of(((mean.as_dvec3() - low) * per_unit).to_array().map(|at| at as u32)))
    };
    let mut rows: Vec<(u128, u32)> = means
        .par_iter()
        .enumerate()
        .map(|(row, mean)| (key(mean).unwrap_or(u128::MAX), u32::try_from(row).expect("rows are counted in u32")))
        .collect();
    rows.par_sort_unstable();
    rows.into_iter().map(|(_, row)| row).collect()
}

#[cfg(test)]
mod tests;
