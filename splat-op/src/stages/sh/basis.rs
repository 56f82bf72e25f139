//! Real spherical harmonics to degree 4 as polynomials of a unit direction, and their gradient.

use std::ops::{Add, Mul, Sub};

use super::SH_COEFFICIENTS_MAX;
use crate::simd::Real;

// Normalisations, named by degree and by position within the degree, with the signs of the original code.
const Y0: f64 = 0.282_094_791_773_878_14;
const Y1: f64 = 0.488_602_511_902_919_9;
const Y2: [f64; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
const Y3: [f64; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];
const Y4: [f64; 9] = [
    2.503_342_941_796_704_6,
    -1.770_130_769_779_930_4,
    0.946_174_695_757_560_1,
    -0.669_046_543_557_289_2,
    0.105_785_546_915_204_31,
    -0.669_046_543_557_289_2,
    0.473_087_347_878_780_04,
    -1.770_130_769_779_930_4,
    0.625_835_735_449_176_1,
];

/// `Yₖ(d)` for `k < (degree+1)²`; the rest is zero.
#[inline(always)]
pub(super) fn basis<F: Real>(direction: [F; 3], degree: usize) -> [F; SH_COEFFICIENTS_MAX] {
    basis_of(direction, degree, F::of)
}

/// [`basis`] of numbers or of vectors of numbers, with `c` for a constant.
#[inline(always)]
pub(crate) fn basis_of<T>([x, y, z]: [T; 3], degree: usize, c: impl Fn(f64) -> T) -> [T; SH_COEFFICIENTS_MAX]
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    let mut out = [c(0.0); SH_COEFFICIENTS_MAX];
    out[0] = c(Y0);
    if degree < 1 {
        return out;
    }
    (out[1], out[2], out[3]) = (c(-Y1) * y, c(Y1) * z, c(-Y1) * x);
    if degree < 2 {
        return out;
    }
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    out[4] = c(Y2[0]) * xy;
    out[5] = c(Y2[1]) * yz;
    out[6] = c(Y2[2]) * (zz + zz - xx - yy);
    out[7] = c(Y2[3]) * xz;
    out[8] = c(Y2[4]) * (xx - yy);
    if degree < 3 {
        return out;
    }
    let four_zz = c(4.0) * zz - xx - yy;
    out[9] = c(Y3[0]) * y * (c(3.0) * xx - yy);
    out[10] = c(Y3[1]) * xy * z;
    out[11] = c(Y3[2]) * y * four_zz;
    out[12] = c(Y3[3]) * z * (zz + zz - c(3.0) * (xx + yy));
    out[13] = c(Y3[4]) * x * four_zz;
    out[14] = c(Y3[5]) * z * (xx - yy);
    out[15] = c(Y3[6]) * x * (xx - c(3.0) * yy);
    if degree < 4 {
        return out;
    }
    let (seven_1, seven_3) = (c(7.0) * zz - c(1.0), c(7.0) * zz - c(3.0));
    out[16] = c(Y4[0]) * xy * (xx - yy);
    out[17] = c(Y4[1]) * yz * (c(3.0) * xx - yy);
    out[18] = c(Y4[2]) * xy * seven_1;
    out[19] = c(Y4[3]) * yz * seven_3;
    out[20] = c(Y4[4]) * (zz * (c(35.0) * zz - c(30.0)) + c(3.0));
    out[21] = c(Y4[5]) * xz * seven_3;
    out[22] = c(Y4[6]) * (xx - yy) * seven_1;
    out[23] = c(Y4[7]) * xz * (xx - c(3.0) * yy);
    out[24] = c(Y4[8]) * (xx * (xx - c(3.0) * yy) - yy * (c(3.0) * xx - yy));
    out
}

/// `Σₖ gₖ ∇Yₖ(d)`: the gradient of the polynomials. Only its component normal to `d` is meaningful on the sphere.
#[inline(always)]
pub(super) fn basis_backward<F: Real>([x, y, z]: [F; 3], degree: usize, g: &[F; SH_COEFFICIENTS_MAX]) -> [F; 3] {
    let c = F::of;
    let mut grad = [F::ZERO; 3];
    let mut term = |weight: F, dx: F, dy: F, dz: F| {
        grad[0] += weight * dx;
        grad[1] += weight * dy;
        grad[2] += weight * dz;
    };
    let zero = F::ZERO;
    if degree < 1 {
        return [zero; 3];
    }
    term(c(Y1), -g[3], -g[1], g[2]);
    if degree < 2 {
        return grad;
    }
    let (two, three, six) = (c(2.0), c(3.0), c(6.0));
    term(c(Y2[0]) * g[4], y, x, zero);
    term(c(Y2[1]) * g[5], zero, z, y);
    term(c(Y2[2]) * g[6], -two * x, -two * y, c(4.0) * z);
    term(c(Y2[3]) * g[7], z, zero, x);
    term(c(Y2[4]) * g[8], two * x, -two * y, zero);
    if degree < 3 {
        return grad;
    }
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    term(c(Y3[0]) * g[9], six * xy, three * (xx - yy), zero);
    term(c(Y3[1]) * g[10], yz, xz, xy);
    term(c(Y3[2]) * g[11], -two * xy, c(4.0) * zz - xx - three * yy, c(8.0) * yz);
    term(c(Y3[3]) * g[12], -six * xz, -six * yz, six * zz - three * (xx + yy));
    term(c(Y3[4]) * g[13], c(4.0) * zz - three * xx - yy, -two * xy, c(8.0) * xz);
    term(c(Y3[5]) * g[14], two * xz, -two * yz, xx - yy);
    term(c(Y3[6]) * g[15], three * (xx - yy), -six * xy, zero);
    if degree < 4 {
        return grad;
    }
    let (seven_1, seven_3, fourteen) = (c(7.0) * zz - F::ONE, c(7.0) * zz - three, c(14.0));
    term(c(Y4[0]) * g[16], y * (three * xx - yy), x * (xx - three * yy), zero);
    term(c(Y4[1]) * g[17], six * xy * z, three * z * (xx - yy), y * (three * xx - yy));
    term(c(Y4[2]) * g[18], y * seven_1, x * seven_1, fourteen * xy * z);
    term(c(Y4[3]) * g[19], zero, z * seven_3, y * (c(21.0) * zz - three));
    term(c(Y4[4]) * g[20], zero, zero, z * (c(140.0) * zz - c(60.0)));
    term(c(Y4[5]) * g[21], z * seven_3, zero, x * (c(21.0) * zz - three));
    term(c(Y4[6]) * g[22], two * x * seven_1, -two * y * seven_1, fourteen * z * (xx - yy));
    term(c(Y4[7]) * g[23], three * z * (xx - yy), -six * xy * z, x * (xx - three * yy));
    term(c(Y4[8]) * g[24], c(4.0) * x * (xx - three * yy), c(4.0) * y * (yy - three * xx), zero);
    grad
}
