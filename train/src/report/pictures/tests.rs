use super::*;

#[test]
fn pictures_are_named_after_their_views() {
    let named = names(["0001.jpg", "left/0001.jpg", "no extension", "a.b.jpeg", "./c.png"], "png");
    let expected = ["0001.png", "left/0001.png", "no extension.png", "a.b.png", "./c.png"];
    assert_eq!(named, expected.map(PathBuf::from));
}

#[test]
fn no_two_pictures_share_a_name() {
    let named = names(["1.jpg", "1.png", "1.tif", "1.tif.png.jpg", "1.tif.jpg"], "png");
    let distinct: HashSet<_> = named.iter().collect();
    assert_eq!(distinct.len(), named.len(), "{named:?}");
    assert_eq!(named[..3], ["1.png", "1.png.png", "1.tif.png"].map(PathBuf::from));
}

#[test]
fn panels_are_truth_render_and_error() {
    let (truth, render) = ([0.2, 0.4, 1.0, 0.0, 0.0, 0.0], [0.2, 0.5, 0.0, 0.0, 0.0, 0.1]);
    let picture = side_by_side(&truth, &render, 2, 1);
    assert_eq!(picture.dimensions(), (6, 1));
    let pixels: Vec<[u8; 3]> = picture.pixels().map(|pixel| pixel.0).collect();
    assert_eq!(pixels[..4], [[51, 102, 255], [0, 0, 0], [51, 128, 0], [0, 0, 26]]);
    assert_eq!(pixels[4..], [[0, 102, 255], [0, 0, 102]]);
}
