//! Gaussians far from all others.
//!
//! The spacing of a Gaussian is its distance to the sixteenth nearest. A Gaussian is isolated if its spacing exceeds the lower quartile
//! of its neighbours' spacings by a factor: the idea of the local outlier factor (Breunig et al. 2000), with a quartile, so that
//! floaters among the neighbours do not count until they are three quarters of them. The factor does not depend on the unit of the
//! scene, nor on its density, which falls with distance. A Gaussian that reaches its neighbours is not isolated: large ones fill in
//! what small ones leave open.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

use crate::gaussians::GaussianRows;

const NEIGHBOURS: usize = 16;

/// The factor from which on `splat clean` takes a Gaussian for isolated.
pub const ISOLATED: f32 = 3.0;

/// Number of its standard deviations within which a Gaussian reaches others.
const EXTENT: f32 = 3.0;

/// Whether each Gaussian is isolated: its spacing is at least `factor` times the lower quartile of its neighbours', and at least three of
/// its largest standard deviation. Centres must be finite. Of 16 or fewer Gaussians none is isolated.
pub fn isolated(rows: &GaussianRows, factor: f32) -> Vec<bool> {
    let means = &rows.means;
    if means.len() <= NEIGHBOURS {
        return vec![false; means.len()];
    }
    let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(means);
    let wanted = std::num::NonZero::new(NEIGHBOURS + 1).expect("one more than sixteen");
    // The nearest is the Gaussian itself, or another at the same place.
    let found: Vec<([u32; NEIGHBOURS], f32)> = means
        .par_iter()
        .map(|mean| {
            let near = tree.nearest_n::<SquaredEuclidean>(mean, wanted);
            (std::array::from_fn(|i| near[i + 1].item as u32), near[NEIGHBOURS].distance.sqrt())
        })
        .collect();
    let is_isolated = |((near, spacing), log_scales): (&([u32; NEIGHBOURS], f32), &[f32; 3])| {
        let extent = EXTENT * log_scales.iter().fold(f32::NEG_INFINITY, |most, log| most.max(*log)).exp();
        let mut others = near.map(|other| found[other as usize].1);
        let (_, quartile, _) = others.select_nth_unstable_by(NEIGHBOURS / 4, f32::total_cmp);
        *spacing > 0.0 && *spacing >= (factor * *quartile).max(extent)
    };
    found.par_iter().zip(&rows.log_scales).map(is_isolated).collect()
}
