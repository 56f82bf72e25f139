//! The first Gaussians of a run.

use rand::Rng;

use super::{Result, Trainer};
use crate::capture::{Photograph, PointCloud, PointsSeen};
use crate::density::rounded_down;
use crate::density::rows::Trained;
use crate::gaussians::{GaussianRows, Gaussians, GroupRows};
use crate::init;

/// The initial Gaussians of a run over `photos` that starts from `points`, or from random ones where there are none, at most `most`; and
/// how many photographs show them.
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
    /// begin at zero, when their degree is due. Further groups of the scene stay, with zeros for the points,
    /// and groups of the run that the scene does not have are zero.
    ///
    /// # Errors
    /// If the scene's rows are inconsistent.
    pub fn from_scene(mut self, scene: &GaussianRows, points: &PointCloud) -> Result<Self> {
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
        rows.groups = GaussianRows::like(scene).groups;
        let count = rows.len();
        rows.groups.iter_mut().for_each(|group| group.values.resize(group.width * count, 0.0));
        rows.reserve_exact(scene.len());
        (0..scene.len()).for_each(|row| rows.push(scene, row));
        for group in self.scene.gaussians.no_rows().groups {
            match rows.groups.iter_mut().find(|own| own.name == group.name && own.width == group.width) {
                Some(own) => own.options = group.options,
                None => rows.groups.push(GroupRows { values: vec![0.0; group.width * rows.means.len()], ..group }),
            }
        }
        let device = self.device.clone().autodiff();
        // The initial Gaussians are gone before the others have moments.
        self.scene = Trained::new(Gaussians::from_own_rows(GaussianRows::default(), &device)?);
        self.scene = Trained::with_bits(Gaussians::from_own_rows(rows, &device)?, self.config.moment_bits);
        Ok(self)
    }
}

#[cfg(test)]
mod tests;
