use glam::DAffine3;
use splat_op::Intrinsics;

use super::*;

/// A grey picture with the given values.
fn picture(value: impl Fn(usize, usize) -> u8) -> Photo {
    let (width, height) = (40, 30);
    let pixels = (0..width * height).flat_map(|i| [value(i % width, i / width); 3]);
    Photo {
        name: "drawn".into(),
        intrinsics: Intrinsics::centred(width, height, 30.0),
        cam_from_world: DAffine3::IDENTITY,
        rgb: pixels.collect(),
        alpha: None,
        mask: None,
    }
}

#[test]
fn sharpness_is_that_of_the_least_sharp_direction() {
    let near = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-12;
    let ramp = sharpness(&picture(|x, _| 3 * x as u8));
    assert!(near(ramp, 1.0 / 9.0), "{ramp:?}");
    assert_eq!(sharpness(&picture(|_, _| 7)), None, "nothing differs");
    let grey: Vec<u8> = (0..40 * 30).map(|i| 3 * (i % 40) as u8).collect();
    assert_eq!(sharpness_of_grey(&grey, [40, 30]), ramp);
    // Stripes two wide differ from every second neighbour and from every second pixel three on.
    for stripes in [picture(|x, _| 90 * (x as u8 / 2 % 2)), picture(|_, y| 90 * (y as u8 / 2 % 2))] {
        let found = sharpness(&stripes).unwrap();
        assert!((0.9..1.1).contains(&found), "{found}");
    }
    // Sharp across and smooth along the stripes: in one direction alone, one of the two pictures would count as sharp.
    let smeared = |across: usize, along: usize| 90 * (across as u8 / 2 % 2) + 3 * along as u8;
    for photo in [picture(smeared), picture(|x, y| smeared(y, x))] {
        let found = sharpness(&photo);
        assert!(near(found, 1.0 / 9.0), "{found:?}");
    }
}
