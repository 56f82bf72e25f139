use super::*;

#[test]
fn a_view_expects_the_most_that_views_like_it_needed_lately() {
    // No other test has pictures of so many tiles.
    let tiles = [70_001, 3];
    assert_eq!(expected(tiles, 1_000), None);
    remember(tiles, 1_000, 8_000);
    remember(tiles, 1_000, 3_000);
    let at = |gaussians| expected(tiles, gaussians).map(|found| found as f64);
    let near = |found: Option<f64>, needed: f64| found.is_some_and(|found| found > needed && found < 1.34 * needed);
    assert!(near(at(1_000), 7_875.0), "{:?}", at(1_000));
    assert!(near(at(2_000), 15_750.0) && near(at(500), 3_937.0), "{:?}, {:?}", at(2_000), at(500));
    assert_eq!((at(2_001), at(499), at(0), expected([3, 70_001], 1_000)), (None, None, None, None));
    for _ in 0..400 {
        remember(tiles, 1_000, 3_000);
    }
    assert!(near(at(1_000), 3_000.0), "{:?}", at(1_000));
    // A view with other Gaussians begins anew.
    remember(tiles, 5_000, 10);
    assert_eq!((at(1_000), at(5_000)), (None, Some(12.0)));
    // Without Gaussians there is nothing to expect.
    remember(tiles, 0, 0);
    assert_eq!((at(0), at(1)), (None, None));
}

#[test]
fn lengths_of_lists_are_few_and_have_headroom() {
    let lengths: Vec<u64> = (100_000..=200_000).map(with_headroom).collect();
    let fits = |(needed, length): (u64, &u64)| *length > needed + needed / 16 && *length < needed * 134 / 100;
    assert!((100_000..).zip(&lengths).all(fits));
    assert!(lengths.chunk_by(|a, b| a == b).count() <= 10);
    assert_eq!([0, 1, 8, 15, 16].map(with_headroom), [1, 2, 10, 16, 20]);
}

#[test]
fn sizes_of_pictures_are_forgotten_when_there_are_others() {
    let tiles = |i| [80_000 + i, 1];
    remember(tiles(0), 10, 10);
    (1..=SIZES).for_each(|i| remember(tiles(i), 10, 10));
    assert_eq!(expected(tiles(0), 10), None);
    assert!(RECENT.lock().unwrap_or_else(PoisonError::into_inner).len() <= SIZES);
}
