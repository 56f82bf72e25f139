//! Half turns between the frame of scenes here, right-down-front, and those of other formats. A half turn is its own inverse.

/// Half a turn about an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HalfTurn {
    /// Between right-down-front and right-up-back.
    X,
    /// Between right-down-front and left-up-front.
    Z,
}

impl HalfTurn {
    /// Signs of a position's axes; the components `x y z` of a rotation have the same signs.
    pub const fn axes(self) -> [f32; 3] {
        match self {
            Self::X => [1.0, -1.0, -1.0],
            Self::Z => [-1.0, -1.0, 1.0],
        }
    }

    /// Sign of the spherical harmonic `k ≥ 1` in the order of the coefficients, `k = l² + l + m`. It is odd in `y` where `m < 0`,
    /// odd in `z` where `l + m` is odd, and changes with half a turn about `z` where `m` is odd.
    pub fn sign(self, k: usize) -> f32 {
        let l = k.isqrt();
        let m = k as isize - (l * l + l) as isize;
        let odd = match self {
            Self::X => (m < 0) != ((l as isize + m) % 2 != 0),
            Self::Z => m % 2 != 0,
        };
        if odd { -1.0 } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use splat_op::sh::harmonics;

    use super::*;

    #[test]
    fn harmonics_are_those_of_the_turned_direction() {
        for turn in [HalfTurn::X, HalfTurn::Z] {
            for d in [[0.48, 0.6, 0.64], [-0.8, 0.36, -0.48], [0.0, -0.6, 0.8]] {
                let turned = [0, 1, 2].map(|axis| d[axis] * f64::from(turn.axes()[axis]));
                let (of, of_turned) = (harmonics(d, 4), harmonics(turned, 4));
                for k in 1..25 {
                    assert!((of_turned[k] - f64::from(turn.sign(k)) * of[k]).abs() < 1e-12, "{turn:?} {k}");
                }
            }
        }
    }
}
