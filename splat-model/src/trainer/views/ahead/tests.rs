use super::*;
use crate::trainer::testing::ring;

#[test]
fn another_size_takes_the_places_of_what_was_there_for_the_last() {
    let photos = ring(MOST + 1);
    let photographs: Vec<Photograph> = photos.into_iter().map(Photograph::from).collect();
    let mut ahead = Ahead::default();
    (0..MOST).for_each(|view| ahead.begin(view, &photographs[view], 1));
    ahead.begin(MOST, &photographs[MOST], 1);
    assert!(!ahead.0.contains_key(&(MOST, 1)), "more than {MOST} at a time");
    (0..MOST).for_each(|view| ahead.begin(view, &photographs[view], 2));
    assert!(ahead.0.keys().eq((0..MOST).map(|view| (view, 2)).collect::<Vec<_>>().iter()));
    for view in 0..MOST {
        ahead.take(view, &photographs[view], 2).unwrap();
    }
    assert!(ahead.0.is_empty());
}
