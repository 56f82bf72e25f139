//! Covariances as factors, as tensor code on every device.

use std::borrow::Cow;

use burn::tensor::{Bool, Tensor};

use super::checked::Checked;
use crate::backend::custom_grad::plain;
use crate::check::check_value;
use crate::{Extras, Result, Splats};

/// Returns the Gaussians as [`project`](mod@crate::project) takes them, and whether factors stand in place of rotations and scales: those of
/// the covariances of `extras`, if there are any.
///
/// `Σ = C Cᵀ` with a lower triangle `C`, by Cholesky's decomposition. Of a covariance that is not positive definite all gradients are zero,
/// and its factor is a zero quaternion, which is culled.
pub(super) fn factored<'a>(checked: &Checked, splats: &'a Splats, extras: &Extras) -> Result<(Cow<'a, Splats>, bool)> {
    let Some(covariances) = &extras.covariances else { return Ok((Cow::Borrowed(splats), false)) };
    let (count, options) = (checked.count, checked.options);
    checked.reference().check("covariances", covariances, [Some(count), Some(3), Some(3)], "[N, 3, 3]")?;
    let expected = "Affine with covariances: RayMax takes rotations and scales";
    check_value("projection", !options.along_rays(), "RayMax", expected)?;
    let expected = "false with covariances: normals are those of rotations and scales";
    check_value("normals", !options.normals, true, expected)?;
    if count == 0 {
        return Ok((Cow::Borrowed(splats), false));
    }
    let tracked = covariances.is_autodiff();
    let (_, bad) = decomposed(&plain(covariances));
    let bad: Tensor<2, Bool> = if tracked { Tensor::from_inner(bad) } else { bad };
    let all = bad.clone().unsqueeze_dim::<3>(2).expand([count, 3, 3]);
    // NaN times a gradient of zero would be NaN.
    let ([xx, yx, yy, zx, zy, zz], _) = decomposed(&covariances.clone().mask_fill(all, 0.0));
    let rotations = Tensor::cat(vec![xx, yx, yy, zx], 1).mask_fill(bad.expand([count, 4]), 0.0);
    let scales = Tensor::cat(vec![zy, zz.clone(), zz.zeros_like()], 1);
    Ok((Cow::Owned(Splats { rotations, scales, ..splats.clone() }), true))
}

/// Returns the columns `C₀₀, C₁₀, C₁₁, C₂₀, C₂₁, C₂₂` of the factors, and which covariances have none; their numbers are arbitrary.
fn decomposed(covariances: &Tensor<3>) -> ([Tensor<2>; 6], Tensor<2, Bool>) {
    let at = |row: usize, column: usize| -> Tensor<2> {
        covariances.clone().narrow(1, row, 1).narrow(2, column, 1).squeeze_dim(2)
    };
    let root = |square: Tensor<2>| {
        let bad = square.clone().greater_elem(0.0).bool_not();
        (square.mask_fill(bad.clone(), 1.0).sqrt(), bad)
    };
    let (xx, bad_x) = root(at(0, 0));
    let (yx, zx) = (at(1, 0) / xx.clone(), at(2, 0) / xx.clone());
    let (yy, bad_y) = root(at(1, 1) - yx.clone().square());
    let zy = (at(2, 1) - zx.clone() * yx.clone()) / yy.clone();
    let (zz, bad_z) = root(at(2, 2) - zx.clone().square() - zy.clone().square());
    ([xx, yx, yy, zx, zy, zz], bad_x.bool_or(bad_y).bool_or(bad_z))
}
