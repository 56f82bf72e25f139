use super::*;

#[test]
fn numbers_have_four_digits() {
    let cases =
        [(0.0, "0"), (1.0, "1.000"), (-12.3456, "-12.35"), (54321.0, "54321"), (1e-4, "1.000e-4"), (-2e7, "-2.000e7")];
    for (value, text) in cases {
        assert_eq!(short(value), text);
    }
}

#[test]
fn bounds_and_quantiles_of_nothing() {
    assert_eq!(bounds(std::iter::empty()), None);
    assert_eq!(quantiles(Vec::new()), Quantiles([0.0; 3]));
    assert_eq!(quantiles((0..=100).rev().map(f64::from).collect()), Quantiles([5.0, 50.0, 95.0]));
}
