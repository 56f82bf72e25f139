//! Scenes of random splats of degree 3 in a cube.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_model::FileError;
use splat_model::gaussians::{GaussianRows, ROWS_AT_ONCE};
use splat_model::ply::{WorldFrame, write_parts};

/// Random splats, the same in each run.
pub struct RandomScene(ChaCha8Rng);

impl Default for RandomScene {
    fn default() -> Self {
        Self(ChaCha8Rng::seed_from_u64(2))
    }
}

impl RandomScene {
    /// The next splats.
    pub fn next_rows(&mut self, count: usize) -> GaussianRows {
        let mut of = |low: f32, high: f32| self.0.random_range(low..high);
        let mut rows = GaussianRows { sh_degree: 3, ..GaussianRows::default() };
        for _ in 0..count {
            rows.means.push([of(-4.0, 4.0), of(-4.0, 4.0), of(-4.0, 4.0)]);
            rows.rotations.push([of(0.1, 1.0), of(-1.0, 1.0), of(-1.0, 1.0), of(-1.0, 1.0)]);
            rows.log_scales.push([of(-6.0, -3.0), of(-6.0, -3.0), of(-7.0, -4.0)]);
            rows.logit_opacities.push(of(-4.0, 5.0));
            rows.sh_dc.push([of(-1.5, 1.5), of(-1.5, 1.5), of(-1.5, 1.5)]);
            rows.sh_rest.extend((0..45).map(|_| of(-0.2, 0.2)));
        }
        rows
    }
}

/// Writes a scene of `count` random splats as PLY, some at a time.
///
/// # Errors
/// If the file cannot be written.
pub fn write(path: &Path, count: usize) -> Result<(), FileError> {
    let mut scene = RandomScene::default();
    let parts = (0..count).step_by(ROWS_AT_ONCE).map(|first| scene.next_rows(ROWS_AT_ONCE.min(count - first)));
    write_parts(path, count, 3, parts, WorldFrame::default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_that_is_written_in_parts_is_read_back_whole() {
        let count = ROWS_AT_ONCE + 3;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ply");
        write(&path, count).unwrap();
        let (rows, _) = splat_model::ply::read(&path).unwrap();
        assert!(rows == RandomScene::default().next_rows(count), "another scene");
        assert!((0..count).all(|row| rows.is_usable(row)));
    }
}
