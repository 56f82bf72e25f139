//! Checks that the options of a configuration fit together and fit the photographs, before a run starts.

use splat_op::{CameraModel, Order, Projection, RenderOptions};

use super::{TrainConfig, TrainError};
use crate::capture::Photograph;

impl TrainConfig {
    /// Checks whether the options can be combined.
    ///
    /// # Errors
    /// If effects on ellipses are combined with a render that has no ellipses.
    pub fn check(&self) -> Result<(), TrainError> {
        if self.along_rays() && self.optics.any() { Err(TrainError::Ellipses) } else { Ok(()) }
    }

    /// Whether pixels are rendered along their rays.
    fn along_rays(&self) -> bool {
        let options = self.dials.apply(RenderOptions::standard());
        options.projection != Projection::Affine || options.order != Order::CentreDepth
    }

    /// [`Self::check`], and whether the run can use the photographs.
    pub(super) fn check_with(&self, photos: &[Photograph]) -> Result<(), TrainError> {
        self.check()?;
        let lens = photos.iter().find(|photo| photo.intrinsics.model != CameraModel::Pinhole);
        match lens.filter(|_| self.along_rays()) {
            Some(photo) => Err(TrainError::Lens { photo: photo.name.clone(), model: photo.intrinsics.model }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::Setting;
    use crate::effects::optics::OpticsConfig;
    use crate::trainer::testing;

    fn photos() -> Vec<Photograph> {
        testing::photos([0.0; 3]).into_iter().map(Photograph::from).collect()
    }

    fn refused(config: TrainConfig) -> String {
        config.check_with(&photos()).unwrap_err().to_string()
    }

    fn dials(dial: &str, value: &str) -> Setting {
        Setting::new([(dial, value)]).unwrap()
    }

    #[test]
    fn rays_go_neither_with_lenses_nor_with_what_changes_ellipses() {
        let rays = TrainConfig { dials: dials("order", "per-pixel-sort"), ..TrainConfig::default() };
        let mut lens = photos();
        lens[2].intrinsics.model = CameraModel::OpenCv;
        TrainConfig::default().check_with(&lens).unwrap();
        rays.check_with(&photos()).unwrap();
        let error = rays.check_with(&lens).unwrap_err().to_string();
        assert!(error.contains("`d`") && error.contains("OpenCv") && error.contains("undistort"), "{error}");
        let optics = OpticsConfig { rolling: true, ..OpticsConfig::default() };
        assert!(refused(TrainConfig { optics, ..rays }).contains("rolling shutters"));
    }
}
