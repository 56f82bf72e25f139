use glam::DAffine3;
use splat_op::Intrinsics;

use super::*;
use crate::gaussians::testing::devices;
use crate::gaussians::values_of;

/// Every value of a byte in every channel.
fn photo(alpha: bool) -> Photo {
    let (width, height) = (37, 7);
    let byte = |i: usize| (i % 256) as u8;
    Photo {
        name: "packed".into(),
        intrinsics: Intrinsics::centred(width, height, 40.0),
        cam_from_world: DAffine3::IDENTITY,
        rgb: (0..width * height).flat_map(|i| [byte(i), byte(3 * i + 200), byte(255 - i % 256)]).collect(),
        alpha: alpha.then(|| (0..width * height).map(|i| byte(7 * i + 100)).collect()),
        mask: None,
    }
}

#[test]
fn a_packed_photograph_is_the_photograph() {
    for device in devices() {
        for (alpha, background) in [(false, [0.0; 3]), (false, [0.1, 0.5, 0.9]), (true, [0.1, 0.5, 0.9])] {
            let photo = photo(alpha);
            let unpacked = PackedPhoto::new(&photo, &device).rgb_over(background);
            assert_eq!(unpacked.dims(), [7, 37, 3]);
            let expected = values_of(photo.rgb_over(background, &device));
            for (found, expected) in values_of(unpacked).iter().zip(expected) {
                assert!((found - expected).abs() <= f32::EPSILON, "{found} instead of {expected}");
            }
        }
    }
}
