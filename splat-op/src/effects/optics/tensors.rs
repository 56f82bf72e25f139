//! The changes of ellipses as tensor code, by their definitions. Numbers are divided by products with reciprocals, because Burn's
//! derivative of a quotient rounds a divisor that is no tensor to f32.

use burn::tensor::Tensor;

use super::{LARGEST_SHARE, OpticsEffect, OpticsSpec, PARAMETERS};
use crate::backend::custom_grad::{constant, plain};
use crate::{Ellipses, Projected, Result};

/// The changed ellipses.
pub(super) fn exposed(of: &Projected, twist: &Tensor<1>, spec: &OpticsSpec) -> Result<Projected> {
    let tracked = of.packed().is_autodiff() || twist.is_autodiff();
    let (old, twist) =
        (Projected::of(constant(of.packed(), tracked), spec.intrinsics).ellipses(), constant(twist, tracked));
    let culled = constant(&plain(&old.depth).equal_elem(0.0), tracked);
    // Nothing may be divided by the zeros of culled Gaussians, not even where the result is dropped.
    let filled = |values: &Tensor<1>| values.clone().mask_fill(culled.clone(), 1.0);
    let [sigma_u, sigma_v, depth] = [&old.sigma_u, &old.sigma_v, &old.depth].map(filled);
    let e = Ellipses { sigma_u, sigma_v, depth, ..old.clone() };
    let velocity = velocity(&e, &twist, spec);
    let new = match spec.exposure {
        OpticsEffect::MotionBlur => widened(e, velocity.map(|v| v * (1.0 / 12.0_f64).sqrt())),
        OpticsEffect::RollingShutter => rolled(e, velocity, spec.intrinsics.height as f64),
    };
    let kept = |new: Tensor<1>, old: Tensor<1>| new.mask_where(culled.clone(), old);
    let both = culled.clone().unsqueeze_dim::<2>(1).expand(old.mean2d.dims());
    let changed = Ellipses {
        mean2d: new.mean2d.mask_where(both, old.mean2d),
        sigma_u: kept(new.sigma_u, old.sigma_u),
        shear: kept(new.shear, old.shear),
        sigma_v: kept(new.sigma_v, old.sigma_v),
        depth: old.depth,
        opacity: kept(new.opacity, old.opacity),
    };
    changed.pack(&spec.intrinsics)
}

fn column(of: &Tensor<2>, axis: usize) -> Tensor<1> {
    of.clone().narrow(1, axis, 1).squeeze_dim(1)
}

/// Per axis, `[N]`: px.
fn velocity(e: &Ellipses, twist: &Tensor<1>, spec: &OpticsSpec) -> [Tensor<1>; 2] {
    let axes = spec.axes();
    let [x, y] = [0, 1].map(|axis| {
        let [focal, principal, low, high] = axes[axis];
        (column(&e.mean2d, axis).clamp(low, high) - principal) * (1.0 / focal)
    });
    let parts: [Tensor<1>; PARAMETERS] = std::array::from_fn(|i| twist.clone().narrow(0, i, 1));
    let [wx, wy, wz, tx, ty, tz] = parts;
    let pull = |shift: Tensor<1>, slope: &Tensor<1>| (shift - slope.clone() * tz.clone()) / e.depth.clone();
    let across = pull(tx, &x) + (x.clone().square() + 1.0) * wy.clone()
        - x.clone() * y.clone() * wx.clone()
        - y.clone() * wz.clone();
    let down = pull(ty, &y) - (y.clone().square() + 1.0) * wx + x.clone() * y * wy + x * wz;
    [across * axes[0][0], down * axes[1][0]]
}

fn hypotenuse(a: Tensor<1>, b: Tensor<1>) -> Tensor<1> {
    (a.square() + b.square()).sqrt()
}

/// The ellipses with the covariance `w wᵀ` added.
fn widened(e: Ellipses, [wx, wy]: [Tensor<1>; 2]) -> Ellipses {
    let sigma_u = hypotenuse(e.sigma_u.clone(), wx.clone());
    let share = e.sigma_u / sigma_u.clone();
    let off = wy.clone() - e.shear.clone() * wx.clone();
    let sigma_v = hypotenuse(e.sigma_v.clone(), share.clone() * off);
    let shear = share.clone().square() * e.shear + (wx / sigma_u.clone()) * (wy / sigma_u.clone());
    let opacity = e.opacity * share * (e.sigma_v / sigma_v.clone());
    Ellipses { mean2d: e.mean2d, sigma_u, shear, sigma_v, depth: e.depth, opacity }
}

/// The ellipses on a sensor of this height, px, that is read row by row.
fn rolled(e: Ellipses, velocity: [Tensor<1>; 2], height: f64) -> Ellipses {
    let [right, down] = velocity.map(|v| v * (1.0 / height));
    let down = down.clamp(-LARGEST_SHARE, LARGEST_SHARE);
    let k = (down.clone().neg() + 1.0).recip();
    let q = k.clone() * right.clone();
    let lag = (column(&e.mean2d, 1) - 0.5 * height) * k.clone();
    let row_u = e.sigma_u.clone() * (q.clone() * e.shear.clone() + 1.0);
    let row_v = q * e.sigma_v.clone();
    let sigma_u = hypotenuse(row_u.clone(), row_v.clone());
    let turned = row_u * (e.shear * e.sigma_u.clone()) + row_v * e.sigma_v.clone();
    let shear = k.clone() * (turned / sigma_u.clone().square());
    let sigma_v = k * e.sigma_v * (e.sigma_u / sigma_u.clone());
    let moved = Tensor::stack(vec![right * lag.clone(), down * lag], 1);
    Ellipses { mean2d: e.mean2d + moved, sigma_u, shear, sigma_v, depth: e.depth, opacity: e.opacity }
}
