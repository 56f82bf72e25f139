//! Lists of the Gaussians in each tile of a picture.

use burn::tensor::{Int, Tensor};

use super::checked::Checked;
use crate::backend::apply;
use crate::intersect::Kept;
use crate::intersect::operation::Intersect;
use crate::rasterize::RasterizeSpec;
use crate::ray_space::operation::BoundRows;
use crate::{Intrinsics, Projected, RenderOptions, Result, SplatError};

/// The intersections of Gaussians and tiles of one view, as [`intersect`](fn@intersect) returns them.
#[derive(Clone, Debug)]
pub struct Intersections {
    /// `[tiles along y, tiles along x]`: number of Gaussians listed in each tile of 16 × 16 px.
    pub counts: Tensor<2, Int>,
    pub(super) lists: Kept,
    /// Number of Gaussians, and what else the lists depend on.
    of: (usize, RasterizeSpec),
}

impl Intersections {
    /// Refuses lists of other Gaussians, of another picture or of other options: kernels do not check the indices in them.
    pub(super) fn check(&self, checked: &Checked, intrinsics: &Intrinsics) -> Result<()> {
        let &Checked { count, options, .. } = checked;
        checked.reference().check_device("intersections", &self.counts.device())?;
        let (listed, of) = &self.of;
        // A smaller `alpha_min` lists more.
        let least = of.options.alpha_min.min(options.alpha_min);
        let size = |of: &Intrinsics| format!("{} × {} px", of.width, of.height);
        let found = if *listed != count {
            format!("lists of {listed} Gaussians, for {count}")
        } else if size(&of.intrinsics) != size(intrinsics) {
            format!("lists of {}, for {}", size(&of.intrinsics), size(intrinsics))
        } else if of.intrinsics != *intrinsics {
            "lists of another camera".into()
        } else if of.options != options.with_alpha_min(least) {
            format!("lists with {:?}, for {options:?}", of.options)
        } else {
            return Ok(());
        };
        let expected = "the result of `intersect` on these ellipses, with these options or a smaller `alpha_min`";
        Err(SplatError::Value { field: "intersections", found, expected })
    }
}

/// Lists the Gaussians that can show in each tile of 16 × 16 px, front to back. Not differentiable.
///
/// # Errors
/// If an option is out of range, if `projected` was not made with `options.projection`, or if
/// `options.alpha_min` is zero and there are more than [`crate::MAX_UNCULLED_INTERSECTIONS`] pairs of a Gaussian and a tile.
pub fn intersect(projected: &Projected, options: &RenderOptions) -> Result<Intersections> {
    let checked = projected.checked(options)?;
    checked.lists(projected.intrinsics())?;
    Ok(listed(&checked, projected, None))
}

/// Returns how many views of this process with [`ListLength::Expected`](crate::ListLength::Expected) are known to lack Gaussians, because
/// they needed longer lists than expected. Later views expect longer ones.
///
/// Never waits: a view counts as soon as the device's number has come in, at the latest once something of its picture has been read.
pub fn truncated_views() -> u64 {
    #[cfg(feature = "cube")]
    crate::intersect::pending::settle();
    crate::counters::truncated()
}

/// [`intersect`](fn@intersect) of inputs that have been checked, in the tiles of a mask, i32, or in all tiles.
pub(super) fn listed(checked: &Checked, projected: &Projected, mask: Option<Tensor<2, Int>>) -> Intersections {
    let lists = Kept::default();
    let spec = RasterizeSpec { intrinsics: projected.intrinsics, options: *checked.options };
    let mut packed = projected.packed.clone().detach();
    if let Some(ray_space) = &projected.ray_space {
        packed = apply(BoundRows(spec), [packed.into(), ray_space.clone().detach().into()]).float(0);
    }
    let counts = apply(Intersect { spec, lists: lists.clone() }, [packed.into(), mask.into()]).int(0);
    Intersections { counts, lists, of: (checked.count, spec) }
}
