//! Helpers that tests of scenes share.

use burn::tensor::Device;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::GaussianRows;

/// Both CPU backends.
pub(crate) fn devices() -> [Device; 2] {
    #[expect(deprecated, reason = "NdArray is the second CPU backend that the project supports")]
    [Device::flex(), Device::ndarray()]
}

/// Rows in which no two numbers are equal, so that tests detect a swapped row, column or field.
pub(crate) fn random_rows(count: usize, sh_degree: usize, seed: u64) -> GaussianRows {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
    for _ in 0..count {
        let mut draw = |from: f32, to: f32| rng.random_range(from..to);
        rows.means.push(std::array::from_fn(|_| draw(-0.6, 0.6)));
        rows.rotations.push(std::array::from_fn(|_| draw(-1.0, 1.0)));
        rows.log_scales.push(std::array::from_fn(|_| draw(-2.5, -1.5)));
        rows.logit_opacities.push(draw(0.0, 3.0));
        rows.sh_dc.push(std::array::from_fn(|_| draw(-1.5, 1.5)));
    }
    rows.sh_rest = (0..count * rows.rest_per_row()).map(|_| rng.random_range(-0.2..0.2)).collect();
    rows
}
