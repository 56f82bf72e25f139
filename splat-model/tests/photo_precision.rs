//! A device's float type can be set once per process, so this test has a process of its own.

use burn::tensor::{DType, Device, FloatDType};
use glam::DAffine3;
use splat_model::capture::Photo;
use splat_op::Intrinsics;

#[test]
fn photos_on_an_f64_device_have_all_its_digits() {
    let mut device = Device::flex();
    device.configure(FloatDType::F64).unwrap();
    let photo = Photo {
        name: "photo".into(),
        intrinsics: Intrinsics::centred(2, 1, 1.0),
        cam_from_world: DAffine3::IDENTITY,
        rgb: vec![0, 1, 2, 3, 254, 255],
        alpha: Some(vec![7, 255]),
        mask: None,
    };
    let rgb = photo.rgb_over([0.0; 3], &device);
    assert_eq!(rgb.dtype(), DType::F64);
    let unit = |byte: f64| byte / 255.0;
    let expected = [0.0, unit(1.0) * unit(7.0), unit(2.0) * unit(7.0), unit(3.0), unit(254.0), 1.0];
    assert_eq!(rgb.into_data().try_to_vec::<f64>().unwrap(), expected);
}
