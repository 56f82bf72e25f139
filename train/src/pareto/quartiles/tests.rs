use super::*;

fn point(quality_db: f64, lower: f64, upper: f64) -> (f64, Quartiles) {
    (quality_db, Quartiles { lower, median: 0.5 * (lower + upper), upper })
}

#[test]
fn quartiles_are_those_of_the_textbook() {
    let of = |values: &[f64]| Quartiles::of(values).map(|found| [found.lower, found.median, found.upper]);
    assert_eq!(of(&[4.0, 1.0, 3.0, 2.0, 5.0]), Some([2.0, 3.0, 4.0]));
    assert_eq!(of(&[1.0, 2.0, 3.0, 10.0]), Some([1.75, 2.5, 4.75]));
    assert_eq!(of(&[7.0]), Some([7.0; 3]));
    assert!(of(&[]).is_none() && of(&[1.0, f64::NAN]).is_none());
}

#[test]
fn quartiles_that_touch_are_not_told_apart() {
    let quartiles = |lower, upper| point(0.0, lower, upper).1;
    assert!(quartiles(1.0, 2.0).is_below(&quartiles(2.1, 3.0)));
    assert!(!quartiles(1.0, 2.0).is_below(&quartiles(2.0, 3.0)));
    assert!(!quartiles(1.0, 4.0).is_below(&quartiles(2.0, 3.0)));
}

#[test]
fn decibels_of_known_errors() {
    assert_eq!(decibels(0.1), 20.0);
    assert!((decibels(0.0) - 300.0).abs() < 1e-9);
    assert!(decibels(f64::NAN).is_nan());
}

#[test]
fn only_what_is_measurably_faster_is_worth_an_error() {
    // 0 is best; 1 is as fast as that; 2 is faster; 3 is faster than 2 but no better than 4; 4 is fastest.
    let points = [
        point(90.0, 9.0, 10.0),
        point(80.0, 9.5, 9.8),
        point(70.0, 5.0, 6.0),
        point(40.0, 3.0, 4.0),
        point(40.0, 1.0, 2.0),
    ];
    assert_eq!(frontier(&points), [0, 2, 4]);
    // Neighbours in this chain overlap, and its ends do not.
    let chain = [point(90.0, 5.0, 7.0), point(80.0, 4.0, 6.0), point(70.0, 3.0, 4.5)];
    assert_eq!(frontier(&chain), [0, 2]);
    assert_eq!(frontier(&[point(f64::NAN, 0.1, 0.2), point(50.0, 1.0, 2.0)]), [1]);
    assert_eq!(frontier(&[point(60.01, 5.0, 6.0), point(60.0, 1.0, 2.0)]), [1], "a hundredth is no difference");
    assert!(frontier(&[]).is_empty());
}
