//! Lists of the tiles of a mask.

use burn::tensor::{Bool, DType, Int, Tensor};

use super::checked::Checked;
use super::intersections::{Intersections, listed};
use crate::intersect::tile_grid;
use crate::{Intrinsics, Projected, RenderOptions, Result, SplatError};

/// Lists the Gaussians as [`intersect`](fn@crate::intersect), in the tiles where `tile_mask` is true; the lists of all others are empty.
///
/// [`rasterize`](fn@crate::rasterize) then shows the background alone in the others, with an alpha of zero, and spends nothing on them.
/// Gradients of Gaussians are those of the tiles of the mask; the background has its gradient everywhere. `tile_mask` is
/// `[tiles along y, tiles along x]`, of tiles of 16 × 16 px. Source: `masks` of gsplat's `rasterize_to_pixels`.
///
/// # Errors
/// As [`intersect`](fn@crate::intersect); if the mask's shape or device does not fit.
pub fn intersect_masked(
    projected: &Projected,
    tile_mask: &Tensor<2, Bool>,
    options: &RenderOptions,
) -> Result<Intersections> {
    let checked = projected.checked(options)?;
    checked.lists(projected.intrinsics())?;
    let mask = checked_mask(&checked, projected.intrinsics(), tile_mask)?;
    Ok(listed(&checked, projected, Some(mask)))
}

/// Checks a mask of the tiles of a picture. Returns it as i32.
pub(super) fn checked_mask(
    checked: &Checked,
    intrinsics: &Intrinsics,
    tile_mask: &Tensor<2, Bool>,
) -> Result<Tensor<2, Int>> {
    let Intrinsics { width, height, .. } = *intrinsics;
    let [tiles_x, tiles_y] = tile_grid(width, height);
    if tile_mask.dims() != [tiles_y, tiles_x] {
        return Err(SplatError::Shape {
            name: "tile_mask",
            found: tile_mask.dims().to_vec(),
            expected: "[tiles along y, tiles along x]",
            hint: format!("a picture of {width} × {height} px has {tiles_y} rows of {tiles_x} tiles of 16 × 16 px"),
        });
    }
    checked.reference().check_device("tile_mask", &tile_mask.device())?;
    let mask = tile_mask.clone().int();
    Ok(if mask.dtype() == DType::I32 { mask } else { mask.cast(DType::I32) })
}
