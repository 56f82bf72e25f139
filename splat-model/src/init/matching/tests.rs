use glam::DMat3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use splat_op::Intrinsics;

use super::*;

/// Height of the terrace over the ground, both level and with a pattern.
const TERRACE: f64 = 0.5;

fn height(x: f64, y: f64) -> f64 {
    if x.abs() < 0.7 && y.abs() < 0.5 { TERRACE } else { 0.0 }
}

/// A pattern that repeats nowhere, 0 to 1: values at the corners of cells of this size, interpolated.
fn pattern(x: f64, y: f64, cell: f64) -> f64 {
    let corner = |i: f64, j: f64| (((i * 127.1 + j * 311.7 + 9.0 / cell).sin() * 43_758.545).fract()).abs();
    let (x, y) = (x / cell, y / cell);
    let (i, j) = (x.floor(), y.floor());
    let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
    let along = |j: f64| mix(corner(i, j), corner(i + 1.0, j), x - i);
    mix(along(j), along(j + 1.0), y - j)
}

fn colour(x: f64, y: f64) -> [u8; 3] {
    let level = 200.0 * (0.4 * pattern(x, y, 0.21) + 0.3 * pattern(x, y, 0.11) + 0.3 * pattern(x, y, 0.045));
    [level as u8, (0.8 * level) as u8 + 20, 90]
}

/// What a ray from above meets first, world frame.
fn hit(from: DVec3, direction: DVec3) -> DVec3 {
    let at = |z: f64| from + direction * ((z - from.z) / direction.z);
    let on_terrace = at(TERRACE);
    if height(on_terrace.x, on_terrace.y) > 0.0 { on_terrace } else { at(0.0) }
}

/// Photographs by cameras in three rows, which look down at the middle.
fn photos(intrinsics: Intrinsics) -> Vec<Photo> {
    let taken = |i: i32| {
        let centre = DVec3::new(0.5 * f64::from(i % 4) - 0.75, 0.5 * f64::from(i / 4) - 0.5, 3.0);
        let z = -centre.normalize();
        let x = DVec3::Y.cross(z).normalize();
        let world_from_cam = DAffine3::from_mat3_translation(DMat3::from_cols(x, z.cross(x), z), centre);
        let projector = intrinsics.projector();
        let pixel = |at: usize| {
            let px = DVec2::new((at % intrinsics.width) as f64 + 0.5, (at / intrinsics.width) as f64 + 0.5);
            let on = hit(centre, world_from_cam.transform_vector3(projector.cam_from_px(px)));
            colour(on.x, on.y)
        };
        let rgb = (0..intrinsics.width * intrinsics.height).flat_map(pixel).collect();
        let cam_from_world = world_from_cam.inverse();
        Photo { name: format!("{i:02}"), intrinsics, cam_from_world, rgb, alpha: None, mask: None }
    };
    (0..12).map(taken).collect()
}

fn pinhole() -> Intrinsics {
    Intrinsics::centred(120, 90, 120.0)
}

fn matched(photos: Vec<Photo>, count: usize) -> PointCloud {
    let photos: Vec<Photograph> = photos.into_iter().map(Photograph::from).collect();
    matched_points(&photos, count, &mut ChaCha8Rng::seed_from_u64(3)).unwrap()
}

/// Shares of the points that are within a hundredth of the cameras' distance of the surface, and of those that have its colour.
fn right(points: &PointCloud) -> [f64; 2] {
    let near = |point: &[f32; 3]| {
        let [x, y, z] = point.map(f64::from);
        // A patch across the terrace's edge may have the depth of either side.
        let heights = [(0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)].map(|(u, v)| height(x + u, y + v));
        heights.iter().any(|height| (z - height).abs() < 0.03)
    };
    let same = |(point, found): (&[f32; 3], &[u8; 3])| {
        let wanted = colour(f64::from(point[0]), f64::from(point[1]));
        (0..3).all(|channel| found[channel].abs_diff(wanted[channel]) < 40)
    };
    let count = points.positions.len() as f64;
    let near = points.positions.iter().filter(|point| near(point)).count();
    let same = points.positions.iter().zip(&points.colours).filter(|pair| same(*pair)).count();
    [near, same].map(|hits| hits as f64 / count)
}

#[test]
fn points_lie_on_surfaces_and_have_their_colours() {
    let points = matched(photos(pinhole()), 1_000);
    assert_eq!(points.positions.len(), 1_000);
    let [near, same] = right(&points);
    assert!(near > 0.96 && same > 0.95, "{near} on the surface, {same} of its colour");
    let high = points.positions.iter().filter(|point| point[2] > 0.4).count();
    assert!((150..600).contains(&high), "{high} on the terrace");
}

#[test]
fn lenses_bend_nothing_but_pictures() {
    let bent = pinhole().with_lens(CameraModel::OpenCv, [-0.2, 0.05, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0]);
    let wide = pinhole().with_lens(CameraModel::Fisheye, [0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    for intrinsics in [bent, wide] {
        let points = matched(photos(intrinsics), 300);
        let [near, _] = right(&points);
        assert!(points.positions.len() == 300 && near > 0.95, "{:?}: {near}", intrinsics.model);
    }
}

#[test]
fn large_photographs_are_compared_smaller() {
    let large = Intrinsics::centred(900, 675, 900.0);
    let points = matched(photos(large), 300);
    let [near, same] = right(&points);
    assert!(points.positions.len() == 300 && near > 0.96 && same > 0.9, "{near} {same}");
}

#[test]
fn pixels_that_do_not_count_give_no_points() {
    let excluded = |mut photo: Photo, masked: bool| {
        let Intrinsics { width, height, .. } = photo.intrinsics;
        let left = (0..width * height).map(|at| at % width < width / 2);
        match masked {
            true => photo.mask = Some(left.map(|left| !left).collect()),
            false => photo.alpha = Some(left.map(|left| if left { 128 } else { 255 }).collect()),
        }
        photo
    };
    for masked in [true, false] {
        let all = photos(pinhole());
        let projector = pinhole().projector();
        let photo = all[5].clone();
        let rest = all.into_iter().map(|photo| excluded(photo, masked)).collect();
        let points = matched(rest, 150);
        assert_eq!(points.positions.len(), 150);
        // Each point is in the right half of the photograph that it comes from, so that all cameras together see few on the left.
        let on_left = |point: &&[f32; 3]| {
            let cam = photo.cam_from_world.transform_point3(DVec3::from(point.map(f64::from)));
            projector.px_from_cam(cam).is_some_and(|px| px.x < 30.0)
        };
        assert!(points.positions.iter().filter(on_left).count() < 10, "masked: {masked}");
    }
}

#[test]
fn nothing_is_found_where_nothing_is_certain() {
    let plain = |photo: Photo| Photo { rgb: photo.rgb.iter().map(|_| 90).collect(), ..photo };
    assert_eq!(matched(photos(pinhole()).into_iter().map(plain).collect(), 50), PointCloud::default());
    assert_eq!(matched(photos(pinhole()).into_iter().take(2).collect(), 50), PointCloud::default(), "two photographs");
    assert_eq!(matched(Vec::new(), 50), PointCloud::default());
    let parallel = pinhole().with_lens(CameraModel::Orthographic, [0.0; 8]);
    let photo = |photo: Photo| Photo { intrinsics: parallel, ..photo };
    assert_eq!(matched(photos(pinhole()).into_iter().map(photo).collect(), 50), PointCloud::default());
    // Stripes look the same from every second stripe on.
    let stripes = |photo: Photo| {
        let rgb = (0..photo.rgb.len()).map(|at| if (at / 3 % 120).is_multiple_of(8) { 250 } else { 10 }).collect();
        Photo { rgb, ..photo }
    };
    let striped = matched(photos(pinhole()).into_iter().map(stripes).collect(), 200);
    assert!(striped.positions.len() < 80, "{} points", striped.positions.len());
}

#[test]
fn the_same_points_are_found_again() {
    let of = || matched(photos(pinhole()), 100);
    assert_eq!(of(), of());
}
