//! The first Gaussians of a run.

use rand::Rng;

use super::{TrainError, Trainer};
use crate::capture::{Photograph, PointCloud, PointsSeen};
use crate::density::rounded_down;
use crate::density::rows::Trained;
use crate::gaussians::{GaussianRows, Gaussians};
use crate::init;

/// The initial Gaussians of a run over `photos` that starts from `points`, or from random points if there are none, at most `most`; and
/// how many photographs show those points.
pub(super) fn first_rows(
    photos: &[Photograph],
    points: &PointCloud,
    most: usize,
    rng: &mut impl Rng,
) -> (GaussianRows, PointsSeen) {
    let cameras: Vec<_> = photos.iter().map(|photo| (photo.intrinsics, photo.cam_from_world)).collect();
    let mut start = init::thinned(&init::distinct(points), most);
    if start.positions.is_empty() {
        start = init::random_points(&cameras, init::RANDOM_COUNT.min(most), rng);
    }
    start.truncate(rounded_down(start.positions.len()));
    let seen = PointsSeen::of(&cameras, &start.positions);
    (init::from_points(&init::ordered(&start)), seen)
}

impl Trainer {
    /// Starts from the Gaussians of a scene, and from as many of `points` as the strategy's cap then has room for. They replace the initial
    /// Gaussians of [`Self::of`], so this must be called before the first step.
    ///
    /// The scene's Gaussians keep their parameters, without the harmonics above the run's degree. Harmonics that the scene does not have
    /// begin at zero, when their degree is due.
    ///
    /// # Errors
    /// If the scene's rows are inconsistent.
    pub fn from_scene(mut self, scene: &GaussianRows, points: &PointCloud) -> Result<Self, TrainError> {
        scene.check()?;
        let room = self.config.density.max_splats().saturating_sub(scene.len());
        let mut rows = match points.positions.is_empty() || room == 0 {
            true => GaussianRows::default(),
            false => {
                let mut points = init::ordered(&init::thinned(&init::distinct(points), room));
                points.truncate(rounded_down(scene.len() + points.positions.len()).saturating_sub(scene.len()));
                init::from_points(&points)
            }
        };
        self.density.start(&mut rows);
        rows.sh_degree = scene.sh_degree.min(self.config.sh_degree);
        rows.sh_rest.reserve_exact(rows.rest_per_row() * (rows.len() + scene.len()));
        rows.sh_rest.resize(rows.rest_per_row() * rows.len(), 0.0);
        rows.reserve_exact(scene.len());
        (0..scene.len()).for_each(|row| rows.push(scene, row));
        let device = self.device.clone().autodiff();
        // The initial Gaussians are gone before the others have moments.
        self.scene = Trained::new(Gaussians::from_own_rows(GaussianRows::default(), &device)?);
        self.scene = Trained::with_bits(Gaussians::from_own_rows(rows, &device)?, self.config.moment_bits);
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::density::AdaptiveConfig;
    use crate::gaussians::testing::random_rows;
    use crate::trainer::TrainConfig;
    use crate::trainer::testing::{photos, points};

    fn started(max_splats: usize, sh_degree: usize, scene: &GaussianRows) -> Trainer {
        let density = AdaptiveConfig { max_splats, ..AdaptiveConfig::default() };
        let config =
            TrainConfig { steps: 9, sh_degree, sh_every: 2, density: density.into(), ..TrainConfig::default() };
        let trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
        trainer.from_scene(scene, &points()).unwrap()
    }

    #[test]
    fn a_run_starts_from_a_scene_and_from_points_while_there_is_room() {
        let scene = random_rows(20, 2, 5);
        // There are thirty points: of all, of every second, of none.
        for (most, from_points) in [(50, 30), (35, 15), (20, 0), (7, 0)] {
            let rows = started(most, 3, &scene).gaussians().to_rows();
            assert_eq!((rows.len(), rows.sh_degree), (from_points + 20, 2), "at most {most}");
            assert_eq!(rows.part(from_points..rows.len()), scene);
            let points = rows.part(0..from_points);
            assert!(points.sh_rest.iter().all(|value| *value == 0.0));
            assert!(points.logit_opacities.iter().all(|logit| (logit + 2.197).abs() < 1e-3), "{points:?}");
        }
    }

    #[test]
    fn harmonics_grow_from_the_degree_of_the_scene() {
        let degrees = |of_scene, of_run| {
            let mut trainer = started(100, of_run, &random_rows(20, of_scene, 5));
            let first = trainer.gaussians().sh_degree();
            while !trainer.is_done() {
                trainer.step().unwrap();
            }
            [first, trainer.gaussians().sh_degree()]
        };
        assert_eq!([degrees(2, 3), degrees(3, 1), degrees(0, 2)], [[2, 3], [1, 1], [0, 2]]);
    }
}
