use super::*;

#[test]
fn a_camera_starts_with_its_focal_length_in_the_middle() {
    let of = |model: CameraModelName| model.parameters(900.5, [640, 481]);
    assert_eq!(of(CameraModelName::SimplePinhole), "900.500,320.0,240.5");
    assert_eq!(of(CameraModelName::SimpleRadial), "900.500,320.0,240.5,0");
    assert_eq!(of(CameraModelName::Opencv), "900.500,900.500,320.0,240.5,0,0,0,0");
}
