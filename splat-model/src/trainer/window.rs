//! A part of the picture at each step: so many of its rows, wherever they are drawn ([`TrainConfig::pixel_share`](super::TrainConfig::pixel_share)). Loss and
//! D-SSIM are those of the part alone, as a mean over its pixels.
//!
//! Gaussians are projected as the whole picture has them, and their ellipses are then moved to where the part begins: the rows
//! are those of the whole picture, for every lens, up to rounding.

use burn::tensor::Tensor;
use rand::{Rng, RngExt};
use splat_op::{Camera, Extras, Intrinsics, RenderOptions, Rendered, SplatError, Splats};
use splat_op::{blend, colours_up_to, project, tile};

use super::views::SMALLEST_SIDE;

/// Rows of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Strip {
    /// The first of them.
    pub from: usize,
    /// How many.
    pub rows: usize,
    /// How many there are.
    pub of: usize,
}

impl Strip {
    /// This share of the rows, or the fewest that the loss is computed on; none where that is all of them, and then nothing is
    /// drawn. Its middle is drawn evenly and the strip is moved into the picture, so that borders are seen too.
    pub fn draw(share: f64, camera: &Intrinsics, rng: &mut impl Rng) -> Option<Self> {
        let of = camera.height;
        let rows = ((share * of as f64).round() as usize).max(SMALLEST_SIDE);
        if share >= 1.0 || rows >= of {
            return None;
        }
        let middle = rng.random_range(0..of);
        Some(Self { from: middle.saturating_sub(rows / 2).min(of - rows), rows, of })
    }

    /// The share of the picture.
    pub fn share(&self) -> f64 {
        self.rows as f64 / self.of as f64
    }

    /// The camera that sees these rows alone.
    fn camera(&self, whole: &Intrinsics) -> Intrinsics {
        Intrinsics { height: self.rows, cy: whole.cy - self.from as f64, ..*whole }
    }

    /// What a camera sees in these rows, for the plain projection and order.
    pub fn render(
        &self,
        splats: &Splats,
        camera: &Camera,
        extras: &Extras,
        options: &RenderOptions,
    ) -> Result<Rendered<3>, SplatError> {
        let projected = project(splats, camera, extras, options)?;
        let mut ellipses = projected.ellipses();
        let origin = Tensor::<2>::from_floats([[0.0, self.from as f32]], &ellipses.mean2d.device());
        ellipses.mean2d = ellipses.mean2d - origin;
        let projected = ellipses.pack(&self.camera(&camera.intrinsics))?;
        let features = colours_up_to(splats, camera, options.sh_degree)?;
        let tiles = tile(&projected, options)?;
        blend(&projected, &features, &tiles, extras, options)
    }
}

#[cfg(test)]
mod tests;
