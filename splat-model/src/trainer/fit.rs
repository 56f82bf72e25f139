//! Whether the parts of a configuration fit together, and the photographs with them: found before a run, not in the middle of it.

use splat_op::{CameraModel, Order, Projection, RenderOptions};

use super::{TrainConfig, TrainError};
use crate::capture::Photograph;
use crate::effects::background::Backdrop;

impl TrainConfig {
    /// Refuses what no run can be.
    ///
    /// # Errors
    /// If [`Self::pixel_share`] is no share, or what is to be simulated needs a whole picture or
    /// ellipses where there are none.
    pub fn check(&self) -> Result<(), TrainError> {
        if !(self.pixel_share > 0.0 && self.pixel_share <= 1.0) {
            return Err(TrainError::PixelShare(self.pixel_share));
        }
        let rays = self.along_rays().then_some("`--projection exact` and `--order per-pixel`");
        let optics = self.optics.any().then_some("motion blur, rolling shutters and defocus");
        if let (Some(rays), Some(optics)) = (rays, optics) {
            return Err(TrainError::Ellipses { rays, optics });
        }
        let environment = matches!(self.backdrop, Backdrop::Environment { .. }).then_some("an environment");
        let grid = self.grid.is_some().then_some("a bilateral grid");
        let depth = self.depth.is_some().then_some("depth supervision");
        let strategy = self.density.strategy(1.0, self.steps);
        // If it looks at all, it does so between two refinements.
        let covered = (1..=self.steps.min(1_000)).any(|step| strategy.listens_at(step).covered);
        let covered = covered.then_some("a strategy that looks at where pictures are wrong");
        match rays.or(optics).or(environment).or(grid).or(depth).or(covered) {
            Some(what) if self.pixel_share < 1.0 => Err(TrainError::WholePicture(what)),
            _ => Ok(()),
        }
    }

    /// Whether pixels look along their rays.
    fn along_rays(&self) -> bool {
        let options = self.dials.apply(RenderOptions::standard());
        options.projection != Projection::Affine || options.order != Order::Centre
    }

    /// The same, and refuses photographs that such a run cannot be trained on.
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
    use crate::density::AdaptiveConfig;
    use crate::effects::depth::DepthConfig;
    use crate::effects::grid::GridConfig;
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
    fn numbers_out_of_range_are_named() {
        for pixel_share in [0.0, -1.0, 1.01, f64::NAN] {
            assert!(refused(TrainConfig { pixel_share, ..TrainConfig::default() }).contains("--pixel-share"));
        }
        TrainConfig { pixel_share: 0.01, ..TrainConfig::default() }.check().unwrap();
    }

    #[test]
    fn what_needs_a_whole_picture_has_one() {
        let motion = OpticsConfig { motion: true, ..OpticsConfig::default() };
        let default = TrainConfig::default;
        for (config, part) in [
            (TrainConfig { optics: motion, ..default() }, "motion blur"),
            (TrainConfig { grid: Some(GridConfig::default()), ..default() }, "a bilateral grid"),
            (TrainConfig { depth: Some(DepthConfig::default()), ..default() }, "depth supervision"),
            (TrainConfig { backdrop: Backdrop::Environment { degree: 1 }, ..default() }, "an environment"),
            (TrainConfig { dials: dials("projection", "exact"), ..default() }, "--projection exact"),
            (TrainConfig { density: AdaptiveConfig::consistent().into(), ..default() }, "a strategy"),
            (TrainConfig { dials: dials("order", "per-pixel"), ..default() }, "--order per-pixel"),
        ] {
            config.check().unwrap();
            let error = refused(TrainConfig { pixel_share: 0.5, ..config });
            assert!(error.contains(part) && error.contains("--pixel-share"), "{error}");
        }
        let colour = TrainConfig { backdrop: Backdrop::Learned, pixel_share: 0.5, ..default() };
        colour.check().unwrap();
    }

    #[test]
    fn rays_go_neither_with_lenses_nor_with_what_changes_ellipses() {
        let rays = TrainConfig { dials: dials("order", "per-pixel"), ..TrainConfig::default() };
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
