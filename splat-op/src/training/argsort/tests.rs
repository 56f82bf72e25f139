//! The sort on every device against the standard library, exactly.

use burn::tensor::{DType, Int, Tensor, TensorData};

use super::{ALL_BITS, argsort, argsort_floats};
use crate::testing::devices;
use crate::testing::random::Random;

/// Lengths around those of a tile of keys on a GPU, and one of several chunks.
const LENGTHS: [usize; 7] = [0, 1, 2, 257, 2_049, 5_000, 70_001];

fn numbers(order: Tensor<1, Int>) -> Vec<i32> {
    assert_eq!(order.dtype(), DType::I32);
    order.into_data().try_into_vec().unwrap()
}

fn expected<T: Copy + PartialOrd>(keys: &[T]) -> Vec<i32> {
    let mut rows: Vec<i32> = (0..keys.len() as i32).collect();
    rows.sort_by(|&a, &b| keys[a as usize].partial_cmp(&keys[b as usize]).unwrap());
    rows
}

#[test]
fn whole_numbers_come_in_stable_order() {
    for device in devices() {
        for (len, bits) in LENGTHS.into_iter().flat_map(|len| [1, 9, 30, ALL_BITS].map(|bits| (len, bits))) {
            let below = (1_u64 << bits) as f64;
            let keys: Vec<i32> = Random::new(len as u64).fill(len, 0.0, below).iter().map(|key| *key as i32).collect();
            let given = Tensor::<1, Int>::from_data(TensorData::new(keys.clone(), [len]), (&device, DType::I32));
            assert!(numbers(argsort(given.clone(), bits)) == expected(&keys), "{len} keys of {bits} bits, {device:?}");
            // The keys are still what they were.
            assert!(numbers(given) == keys, "{len} keys of {bits} bits, {device:?}");
        }
    }
}

#[test]
fn floats_come_in_stable_order_and_nan_last() {
    for device in devices() {
        for len in LENGTHS {
            let mut keys: Vec<f32> =
                Random::new(len as u64).fill(len, -90.0, 88.0).iter().map(|log| log.exp() as f32).collect();
            (0..len).step_by(3).for_each(|row| keys[row] = 0.0);
            let mut with_nan = keys.clone();
            let given = Tensor::<1>::from_data(TensorData::new(keys.clone(), [len]), &device);
            assert!(numbers(argsort_floats(given)) == expected(&keys), "{len} keys, {device:?}");
            if len > 2 {
                (with_nan[1], keys[1]) = (f32::NAN, f32::INFINITY);
                let given = Tensor::<1>::from_data(TensorData::new(with_nan, [len]), &device);
                assert!(numbers(argsort_floats(given)) == expected(&keys), "{len} keys and NaN, {device:?}");
            }
        }
    }
}
