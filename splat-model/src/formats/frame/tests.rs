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
