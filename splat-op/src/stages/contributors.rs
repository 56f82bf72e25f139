//! The Gaussians that a pixel is made of, by their ids.

use burn::tensor::{Int, Tensor};

use crate::backend::{Slot, apply};
use crate::check::check_value;
use crate::limits::Need;
use crate::rasterize::RasterizeSpec;
use crate::rasterize::operation::Contribute;
use crate::{Intersections, Intrinsics, Projected, RenderOptions, Result};

/// Largest number of contributors that [`contributors`] returns for a pixel.
pub const MAX_CONTRIBUTORS: usize = 1024;

/// The contributors of each pixel of a view, as [`contributors`] returns them. An id is the row of a Gaussian.
#[derive(Clone, Debug)]
pub struct Contributors {
    /// `[H, W, K]`: ids of the first `K` Gaussians that contribute to a pixel, front to back; −1 where there are fewer.
    pub ids: Tensor<3, Int>,
    /// `[H, W, K]`: their weights `wᵢ = αᵢ Tᵢ`, zero where there are fewer. Where there are at most `K` Gaussians, they sum up to the
    /// pixel's alpha. Without gradient.
    pub weights: Tensor<3>,
    /// `[H, W]`: id of the contributor behind which the transmittance is 0.5 or less for the first time; −1 where it stays above.
    pub median: Tensor<2, Int>,
    depths: Tensor<1>,
}

impl Contributors {
    /// Returns the median depth `[H, W, 1]`, scene units: the camera z of the centre of the Gaussian [`median`](Self::median), and zero
    /// where there is none. Differentiable in the depth of that Gaussian.
    ///
    /// Source: gsplat's `rasterization_2dgs` (commit 90d7b4b, `RasterizeToPixels2DGSSerialBatchFwd.cu`; Huang et al. 2024). It takes
    /// the last contributor in front of which the transmittance is above 0.5, which is the same Gaussian, except where the transmittance
    /// stays above 0.5: there gsplat has the depth of the last contributor.
    pub fn median_depth(&self) -> Tensor<3> {
        let [height, width] = self.median.dims();
        if self.depths.dims()[0] == 0 {
            return Tensor::zeros([height, width, 1], (&self.depths.device(), self.depths.dtype()));
        }
        let ids = self.median.clone().reshape([height * width]);
        let none = ids.clone().lower_elem(0);
        let depths = self.depths.clone().select(0, ids.clamp_min(0)).mask_fill(none, 0.0);
        depths.reshape([height, width, 1])
    }
}

/// Returns the first `k` Gaussians that contribute to each pixel, with their weights, and the one at its median.
///
/// A Gaussian contributes where [`rasterize`](fn@crate::rasterize) with these options blends it, in the same order, with both projections:
/// not below `alpha_min`, and not behind `transmittance_min`. `intersections` must come from `projected` with the same options; a smaller
/// `alpha_min` serves too. Not differentiable, but for [`Contributors::median_depth`]. Source: gsplat's
/// `rasterize_contributing_gaussian_ids`, with a fixed number for each pixel.
///
/// # Errors
/// If `k` is zero or above [`MAX_CONTRIBUTORS`], if a result would be larger than the device allows, if an option is out of range, if
/// `projected` was not made with `options.projection`, or if `intersections` are of other Gaussians, another camera or other options.
pub fn contributors(
    projected: &Projected,
    intersections: &Intersections,
    k: usize,
    options: &RenderOptions,
) -> Result<Contributors> {
    let checked = projected.checked(options)?;
    check_value("k", (1..=MAX_CONTRIBUTORS).contains(&k), k, "1 to 1024 contributors")?;
    let Intrinsics { width, height, .. } = projected.intrinsics;
    let hint = "ask for fewer contributors of a pixel, or render a smaller picture";
    checked.reference().check_fits(&[Need::floats("the contributors", [height, width, k], hint)])?;
    intersections.check(&checked, projected.intrinsics())?;
    // Depth is not rendered.
    let spec = RasterizeSpec { intrinsics: projected.intrinsics, options: options.with_depth(false) };
    let operation = Contribute { spec, lists: intersections.lists.clone(), most: k };
    let packed = projected.packed.clone().detach();
    let ray_space = projected.ray_space.clone().map(Tensor::detach);
    let (none, counts) = (|| Slot::Absent, &intersections.counts);
    let mut found = apply(operation, [packed.into(), none(), none(), none(), ray_space.into(), counts.into()]);
    Ok(Contributors {
        ids: found.int(0),
        weights: found.float(1),
        median: found.int(2),
        depths: projected.ellipses().depth,
    })
}
