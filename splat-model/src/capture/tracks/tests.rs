use super::*;

#[test]
fn each_point_has_its_own_observations() {
    let observation = |view, x| Observation { view, at_px: [x, 2.0] };
    let mut tracks = Tracks::default();
    tracks.push([observation(0, 1.0), observation(3, 4.0)], 0.5);
    tracks.push([], -1.0);
    tracks.push([observation(1, f32::NAN), observation(2, 9.0)], f64::NAN);
    let views = |point| tracks.of(point).iter().map(|observation| observation.view).collect::<Vec<_>>();
    assert_eq!([views(0), views(1), views(2), views(3)], [vec![0, 3], vec![], vec![2], vec![]]);
    assert_eq!(tracks.observations(), 3);
    assert_eq!([0, 1, 2, 3].map(|point| tracks.stated_error_px(point)), [Some(0.5), None, None, None]);
}
