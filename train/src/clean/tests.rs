use super::*;

#[test]
fn a_box_lies_between_any_two_corners() {
    let of = |text: &str| text.parse::<CropBox>();
    let crop = of("1,-2, 3,-1,2,-3").unwrap();
    assert_eq!(crop, CropBox([[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]]));
    assert!(crop.holds(&[1.0, 2.0, -3.0]) && !crop.holds(&[1.1, 0.0, 0.0]) && !crop.holds(&[f32::NAN, 0.0, 0.0]));
    // Half of space.
    assert!(of("-inf,-inf,0,inf,inf,inf").unwrap().holds(&[1e30, -1e30, 0.5]));
    for text in ["", "1,2,3", "1,2,3,4,5,6,7", "a,2,3,4,5,6", "nan,2,3,4,5,6"] {
        assert!(of(text).unwrap_err().contains("six coordinates"), "{text}");
    }
}
