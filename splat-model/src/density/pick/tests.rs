use super::*;
use crate::gaussians::testing::devices;

fn ints(values: Tensor<1, Int>) -> Vec<i64> {
    values.into_data().iter().collect()
}

fn on(device: &Device, values: &[u32]) -> Tensor<1, Int> {
    rows_on(device, values)
}

#[test]
fn a_scene_has_whole_vectors_of_rows_or_few() {
    assert_eq!([0, 7, 1023, 1024, 1031, 9_999].map(rounded_down), [0, 7, 1023, 1024, 1024, 9_992]);
    // New rows go first; else rows stay that would go.
    assert_eq!(whole(2_000, 20, 9), (16, 0));
    assert_eq!(whole(2_003, 20, 9), (13, 0));
    assert_eq!(whole(2_003, 2, 9), (2, 3));
    assert_eq!(whole(2_003, 2, 2), (2, 0));
    assert_eq!(whole(2_000, 0, 9), (0, 0));
    assert_eq!(whole(100, 3, 9), (3, 0));
}

#[test]
fn masks_and_values_choose_rows() {
    for device in devices() {
        let values = Tensor::<1>::from_floats([0.5, 0.0, 3.0, 2.0, 3.0], &device);
        let mask = values.clone().greater_elem(1.0);
        assert_eq!(counts([mask.clone(), mask.clone().bool_not()]), [3, 2]);
        assert_eq!(ints(picked(&on(&device, &[4, 1, 3, 0, 2]), &mask, 3)), [4, 3, 2]);
        let all = || values.clone().greater_equal_elem(0.0);
        let cases = [(0, vec![], Some(3.0)), (1, vec![4], Some(3.0)), (3, vec![2, 3, 4], Some(0.5))];
        for (count, expected, next) in cases {
            let (mask, found) = largest(&values, &all(), count);
            assert_eq!(ints(picked(&all_rows(5, &device), &mask, count)), expected, "{count}");
            assert_eq!(found, next, "{count}");
        }
        assert_eq!(largest(&values, &all(), 5).1, None);
        // Of those below one, zero too.
        let (mask, next) = largest(&values, &mask.bool_not(), 2);
        assert_eq!((ints(picked(&all_rows(5, &device), &mask, 2)), next), (vec![0, 1], Some(3.0)));
    }
}

#[test]
fn rows_are_repeated_in_order() {
    for device in devices() {
        assert_eq!(ints(running_sums(on(&device, &[3, 0, 2, 1, 4]))), [3, 3, 5, 6, 10]);
        assert_eq!(ints(repeated(on(&device, &[0, 3, 0, 0, 1, 2, 0]), 6)), [1, 1, 1, 4, 5, 5]);
        let copies: Vec<u32> = (0..3_000).map(|i| i * i % 4).collect();
        let expected: Vec<i64> = (0..3_000).flat_map(|row| vec![row as i64; copies[row as usize] as usize]).collect();
        assert_eq!(ints(repeated(on(&device, &copies), expected.len())), expected);
    }
}
