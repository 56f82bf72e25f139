use glam::{DAffine3, DVec2, DVec3};

use super::*;

fn photo(alpha: Option<Vec<u8>>) -> Photo {
    let (width, height) = (5, 4);
    Photo {
        name: "five by four".into(),
        intrinsics: Intrinsics::pinhole(width, height, [6.0, 6.0], [2.25, height as f64 / 2.0]),
        cam_from_world: DAffine3::IDENTITY,
        rgb: (0..60).collect(),
        alpha,
        mask: Some((0..20).map(|i| i != 6).collect()),
    }
}

#[test]
fn pixels_are_means_and_the_camera_looks_the_same_way() {
    let small = photo(None).box_filtered(2).unwrap();
    assert_eq!((small.intrinsics.width, small.intrinsics.height), (2, 2));
    // Red of the first: pixels 0, 1, 5 and 6.
    assert_eq!(small.rgb[0], (3 + 15 + 18) / 4);
    assert_eq!(small.rgb[3 * 3 + 2], ((12 + 13 + 17 + 18) * 3 / 4 + 2) as u8);
    assert_eq!(small.mask.as_deref(), Some(&[false, true, true, true][..]));
    let point = DVec3::new(0.3, -0.2, 1.5);
    let (full, half) =
        (photo(None).intrinsics.px_from_cam(point).unwrap(), small.intrinsics.px_from_cam(point).unwrap());
    assert!((full / 2.0).abs_diff_eq(half, 1e-12) && full != DVec2::ZERO);
    assert!(photo(None).box_filtered(5).is_none());
}

#[test]
fn transparent_pixels_give_no_colour() {
    let mut alpha = vec![255; 20];
    (alpha[0], alpha[1], alpha[5]) = (0, 0, 0);
    let small = photo(Some(alpha)).box_filtered(2).unwrap();
    assert_eq!(&small.rgb[..3], &[18, 19, 20]);
    assert_eq!(small.alpha.unwrap()[..2], [64, 255]);
}
