use burn::tensor::{DType, Int};

use super::*;
use crate::gaussians::testing::devices;
use crate::gaussians::values_of;

#[test]
fn pieces_have_the_sums_and_bounds_of_rows() {
    for device in devices() {
        for length in [1, LONG, LONG + 1, 20 * PIECE, 30_011] {
            let ints = Tensor::<1, Int>::arange(0..2 * length as i64, (&device, DType::I32)).reshape([2, length]);
            let rows = ints.clone().float().cast(DType::F32);
            let sums = folded(ints, 0.0).sum_dim(2).sum_dim(1);
            let half = (length * (length - 1) / 2) as i64;
            let expected = [half, half + (length * length) as i64];
            assert_eq!(sums.into_data().iter::<i64>().collect::<Vec<_>>(), expected, "{length}");
            let least = folded(rows, f32::MAX.into()).min_dim(2).min_dim(1);
            assert_eq!(values_of(least), [0.0, length as f32]);
        }
    }
}
