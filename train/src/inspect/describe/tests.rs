use super::*;

#[test]
fn bounds_and_quantiles_of_nothing() {
    assert_eq!(bounds(std::iter::empty()), None);
    assert_eq!(quantiles(Vec::new()), [0.0; 3]);
    assert_eq!(quantiles((0..=100).rev().map(f64::from).collect()), [5.0, 50.0, 95.0]);
}
