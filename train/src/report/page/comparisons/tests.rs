use super::*;

#[test]
fn pages_have_room_for_both_ends() {
    let order: Vec<usize> = (0..100).collect();
    assert_eq!(worst_and_best(&order[..MOST]), order[..MOST]);
    assert_eq!(worst_and_best(&order), [&order[..12], &order[88..]].concat());
}

#[test]
fn panels_are_taken_apart_and_made_smaller() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let shades = |x: u32| if x < 1000 { [200, 0, 0] } else { [0, 0, 200] };
    RgbImage::from_fn(3000, 500, |x, _| image::Rgb(shades(x))).save(&path).unwrap();
    let comparison = PictureComparison::read(7, &path).unwrap();
    assert_eq!((comparison.view, comparison.width, comparison.height), (7, 1000, 500));
    for (address, channel) in [(&comparison.truth, 0), (&comparison.render, 2)] {
        let bytes = BASE64_STANDARD.decode(address.strip_prefix("data:image/jpeg;base64,").unwrap()).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!(picture.dimensions(), (800, 400));
        let pixel = picture.get_pixel(400, 200).0;
        assert!(pixel[channel] > 190 && pixel[2 - channel] < 10, "{pixel:?}");
    }
    assert!(PictureComparison::read(7, folder.path()).is_none());
}
