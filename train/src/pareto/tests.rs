use super::*;

#[test]
fn views_are_spread_evenly() {
    assert_eq!(spread(&[3, 5, 7, 9, 11, 13], 3), [3, 7, 11]);
    assert_eq!(spread(&[3, 5], 3), [3, 5]);
    assert_eq!(spread(&[3], 1), [3]);
    assert!(spread(&[], 3).is_empty());
}
