//! The operations as tensor code, by their definitions.

use burn::tensor::{Bool, DType, Int, Tensor};

use super::{LARGEST, LARGEST_LOG_SCALE, RawSplats};
use crate::backend::custom_grad::{constant, plain};

/// `[N]`: the rows in which all numbers are set.
fn all(mask: Tensor<2, Bool>) -> Tensor<1, Bool> {
    mask.all_dim(1).squeeze_dim(1)
}

fn bounded(values: Tensor<2>) -> Tensor<1, Bool> {
    all(values.abs().lower_equal_elem(LARGEST))
}

/// Standard deviations and opacities. Unusable numbers are replaced before anything is computed from them, because a derivative that is
/// not finite would turn a gradient of zero into NaN.
pub(super) fn activated(raw: &RawSplats) -> (Tensor<2>, Tensor<1>) {
    let [count, coefficients, _] = raw.sh.dims();
    let (rotations, logs, logits) = (plain(&raw.rotations), plain(&raw.log_scales), plain(&raw.logit_opacities));
    let usable_logs = logs.clone().is_finite().bool_and(logs.lower_equal_elem(LARGEST_LOG_SCALE));
    let turned = rotations.clone().not_equal_elem(0.0).any_dim(1).squeeze_dim(1);
    let geometry = [all(usable_logs.clone()), all(rotations.is_finite()), turned, logits.clone().is_finite()];
    let mut usable = geometry.into_iter().fold(bounded(plain(&raw.means)), Tensor::bool_and);
    if coefficients > 0 {
        usable = usable.bool_and(bounded(plain(&raw.sh).reshape([count, 3 * coefficients])));
    }
    let tracked = raw.log_scales.is_autodiff() || raw.logit_opacities.is_autodiff();
    let (no_log, no_splat) = (constant(&usable_logs.bool_not(), tracked), constant(&usable.bool_not(), tracked));
    let scales = constant(&raw.log_scales, tracked).mask_fill(no_log.clone(), 0.0).exp().mask_fill(no_log, 0.0);
    // The exponent is never positive, so that nothing overflows. Its sign is a constant.
    let below = logits.lower_elem(0.0);
    let sign = below.clone().float().cast(raw.logit_opacities.dtype()) * 2.0 - 1.0;
    let logits = constant(&raw.logit_opacities, tracked).mask_fill(no_splat.clone(), 0.0);
    let e = (logits * constant(&sign, tracked)).exp();
    let opacities = e.clone().mask_fill(constant(&below.bool_not(), tracked), 1.0) / (e + 1.0);
    (scales, opacities.mask_fill(no_splat, 0.0))
}

/// `[1]`: 1 if any value is not finite, else 0.
pub(super) fn non_finite<const D: usize>(values: Tensor<D>) -> Tensor<1, Int> {
    values.is_finite().bool_not().any().int().cast(DType::I32)
}
