//! The checks of a render's inputs. Each input is checked once: by `render` for all stages, or by a stage that is called alone.

use std::slice;

use burn::tensor::Tensor;

use crate::check::{Reference, check_value};
use crate::intersect::tile_grid;
use crate::limits::Need;
use crate::project::COLUMNS;
use crate::rasterize::RasterizeSpec;
use crate::sh::sh_degree;
use crate::{Camera, CameraModel, Colour, Intrinsics, RenderOptions, Result, SplatError, Splats};

/// Options in range, and the number of rows, the float type and the device that the tensors of a picture share.
///
/// Only [`Self::new`] and [`Self::gaussians`] make one. Its methods check what goes with it; a function that takes it checks nothing again.
pub(crate) struct Checked<'a> {
    pub options: &'a RenderOptions,
    /// The number of Gaussians.
    pub count: usize,
    reference: Reference,
}

impl<'a> Checked<'a> {
    /// Checks options, and the float type of `rows`, which has a row per Gaussian.
    pub fn new(name: &'static str, rows: &Tensor<2>, options: &'a RenderOptions) -> Result<Self> {
        options.check()?;
        Ok(Self { options, count: rows.dims()[0], reference: Reference::new(name, rows)? })
    }

    /// Checks options, and Gaussians without their colours.
    pub fn gaussians(splats: &Splats, options: &'a RenderOptions) -> Result<Self> {
        let checked = Self::new("means", &splats.means, options)?;
        let (reference, count) = (&checked.reference, Some(checked.count));
        reference.check("means", &splats.means, [count, Some(3)], "[N, 3]")?;
        reference.check("rotations", &splats.rotations, [count, Some(4)], "[N, 4]")?;
        reference.check("scales", &splats.scales, [count, Some(3)], "[N, 3]")?;
        reference.check("opacities", &splats.opacities, [count], "[N]")?;
        reference.check_fits(&[packed_need(checked.count)])?;
        Ok(checked)
    }

    pub fn reference(&self) -> &Reference {
        &self.reference
    }

    pub fn camera(&self, camera: &Camera) -> Result<()> {
        camera.intrinsics.check()?;
        let ok = !self.options.along_rays() || camera.intrinsics.model != CameraModel::Orthographic;
        let expected = "Affine, whose ellipse is the maximum along parallel rays";
        check_value("projection", ok, "RayMax for an orthographic camera", expected)?;
        self.pose(camera)
    }

    pub fn pose(&self, camera: &Camera) -> Result<()> {
        self.reference.check("cam_from_world", &camera.cam_from_world, [Some(3), Some(4)], "[3, 4]")
    }

    pub fn colour(&self, colour: &Colour) -> Result<()> {
        match colour {
            Colour::Features(features) => self.features(features),
            Colour::SphericalHarmonics(sh) => self.harmonics(slice::from_ref(sh)),
            Colour::SphericalHarmonicsBlocks(blocks) => self.harmonics(blocks),
        }
    }

    pub fn features(&self, features: &Tensor<2>) -> Result<()> {
        self.reference.check("features", features, [Some(self.count), None], "[N, C]")?;
        check_value("features", features.dims()[1] > 0, 0, "at least one channel")
    }

    fn harmonics(&self, blocks: &[Tensor<3>]) -> Result<()> {
        const EXPECTED: &str = "[N, (degree+1)², 3] with degree 0 to 4";
        const HINT: &str = "use fewer Gaussians or a lower degree of the spherical harmonics, or several tensors \
                            (`Colour::SphericalHarmonicsBlocks`)";
        let wrong = |found, expected, hint| SplatError::Shape { name: "sh", found, expected, hint };
        let rows: Vec<usize> = blocks.iter().map(|sh| sh.dims()[0]).collect();
        if rows.len() != 1 && (rows.is_empty() || rows.iter().sum::<usize>() != self.count) {
            return Err(wrong(rows, "blocks with N rows together", format!("there are {} Gaussians", self.count)));
        }
        for sh in blocks {
            let rows = (blocks.len() == 1).then_some(self.count);
            self.reference.check("sh", sh, [rows, None, Some(3)], EXPECTED)?;
            if sh_degree(sh.dims()[1]).is_none() {
                let hint = "give 1, 4, 9, 16 or 25 coefficients per channel".into();
                return Err(wrong(sh.dims().to_vec(), EXPECTED, hint));
            }
            self.reference.check_fits(&[Need::floats("sh", sh.dims(), HINT)])?;
        }
        Ok(())
    }

    /// Checks a background of so many channels; zeros if there is none.
    pub fn background(&self, background: Option<Tensor<1>>, channels: usize) -> Result<Tensor<1>> {
        let background = background.unwrap_or_else(|| Tensor::zeros([channels], self.reference.options()));
        self.reference.check("background", &background, [Some(channels)], "[C]")?;
        Ok(background)
    }

    /// Checks a probe; without rows if there is none. Burn's fusion would put zeros of no rows into one kernel with pending
    /// results of one row, and launch it for no rows.
    pub fn probe(&self, name: &'static str, probe: Option<&Tensor<2>>) -> Result<Tensor<2>> {
        let Some(probe) = probe else { return Ok(Tensor::empty([0, 2], self.reference.options())) };
        self.reference.check(name, probe, [Some(self.count), Some(2)], "[N, 2]")?;
        Ok(probe.clone())
    }

    /// Refuses to list every Gaussian in every tile if there are too many pairs.
    pub fn lists(&self, intrinsics: &Intrinsics) -> Result<()> {
        let [tiles_x, tiles_y] = tile_grid(intrinsics.width, intrinsics.height);
        self.options.check_uncut(self.count, tiles_x * tiles_y)
    }

    /// Refuses features and a picture of so many channels that do not fit into a buffer.
    pub fn picture(&self, intrinsics: &Intrinsics, channels: usize) -> Result<()> {
        let spec = RasterizeSpec { intrinsics: *intrinsics, options: self.options.of_rasterize() };
        let picture = [spec.planes(channels), intrinsics.height, intrinsics.width];
        self.reference.check_fits(&[
            Need::floats("features", [self.count, channels], "use fewer Gaussians or fewer channels"),
            Need::floats("the picture", picture, "render a smaller picture, parts of it one by one, or fewer channels"),
        ])
    }
}

/// The buffer of packed ellipses.
pub(super) fn packed_need(count: usize) -> Need {
    Need::floats("projected", [count, COLUMNS], "use fewer Gaussians")
}
