use super::*;

#[test]
fn ranges_need_no_more_than_the_room() {
    let ranges = |needs: &[usize], room| split(needs.len(), room, |end| needs[..end].iter().sum());
    let one = |range: Range<usize>| vec![range];
    assert_eq!(ranges(&[3, 4, 0, 9, 1, 1], 7), [0..3, 3..4, 4..6]);
    assert_eq!(ranges(&[20, 20], 7), [0..1, 1..2]);
    assert_eq!(ranges(&[0, 0], 0), one(0..2));
    assert_eq!(ranges(&[5], 7), one(0..1));
    assert_eq!(ranges(&[], 7), one(0..0));
}

#[test]
fn numbers_of_units_and_elements_fit_into_u32() {
    let largest = (INDEX_LIMIT / 4) as usize;
    for elements in [largest, largest - 1, largest - CUBES_X * UNITS + 1] {
        let (CubeCount::Static(x, y, z), _) = elementwise(elements) else { panic!("a static count") };
        let units = [x, y, z].iter().try_fold(UNITS as u32, |units, count| units.checked_mul(*count));
        assert!(units.is_some_and(|units| units as usize >= elements), "{units:?} units for {elements} elements");
    }
    let (_, _, stride) = search(largest);
    assert!((largest as u32).checked_add(stride).is_some());
}
