//! Conversion between right-down-front and right-up-back. Both directions are half a turn about `x`.

/// Signs of a position's axes under half a turn about `x`; the components `x y z` of a rotation have the same signs.
pub(super) const AXES: [f32; 3] = [1.0, -1.0, -1.0];

/// Sign of the spherical harmonic `k ≥ 1` in the order of the coefficients, `k = l² + l + m`. It is odd in `y` where `m < 0`,
/// and odd in `z` where `l + m` is odd.
pub(super) fn sign(k: usize) -> f32 {
    let l = k.isqrt();
    let m = k as isize - (l * l + l) as isize;
    let odd = (m < 0) != ((l as isize + m) % 2 != 0);
    if odd { -1.0 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use splat_op::sh::harmonics;

    use super::*;

    #[test]
    fn harmonics_are_those_of_the_turned_direction() {
        for d in [[0.48, 0.6, 0.64], [-0.8, 0.36, -0.48], [0.0, -0.6, 0.8]] {
            let turned = [0, 1, 2].map(|axis| d[axis] * f64::from(AXES[axis]));
            let (of, of_turned) = (harmonics(d, 4), harmonics(turned, 4));
            for k in 1..25 {
                assert!((of_turned[k] - f64::from(sign(k)) * of[k]).abs() < 1e-12, "{k}");
            }
        }
    }
}
