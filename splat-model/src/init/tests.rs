use std::f64::consts::TAU;

use burn::tensor::Device;
use glam::{DMat3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::{Camera, evaluate_sh};

use super::*;
use crate::gaussians::{Gaussians, values_of};

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn grey(positions: Vec<[f32; 3]>) -> PointCloud {
    PointCloud { colours: vec![[128; 3]; positions.len()], positions }
}

/// The standard deviation of each Gaussian; all are round.
fn sizes(points: &PointCloud) -> Vec<f32> {
    let rows = from_points(points);
    rows.check().unwrap();
    rows.log_scales.iter().map(|[x, y, z]| (*x == *y && *y == *z).then(|| x.exp()).expect("round")).collect()
}

#[test]
fn size_is_the_root_mean_square_distance_to_three_neighbours() {
    let mut rng = rng(1);
    let positions: Vec<[f32; 3]> = (0..300).map(|_| std::array::from_fn(|_| rng.random_range(-3.0..3.0))).collect();
    let found = sizes(&grey(positions.clone()));
    for (i, found) in found.into_iter().enumerate() {
        let distance = |other: &[f32; 3]| Vec3::from(*other).distance_squared(positions[i].into());
        let mut squared: Vec<f32> = positions.iter().map(distance).collect();
        squared.sort_by(f32::total_cmp);
        let expected = (squared[1..4].iter().sum::<f32>() / 3.0).sqrt();
        assert!((found - expected).abs() <= 1e-5 * expected, "point {i}: {found} instead of {expected}");
    }
}

#[test]
fn few_points_use_the_neighbours_there_are() {
    assert!(sizes(&grey(vec![])).is_empty());
    assert_eq!(sizes(&grey(vec![[5.0, 6.0, 7.0]])), [1.0]);
    let two = sizes(&grey(vec![[0.0; 3], [0.0, 3.0, 4.0]]));
    assert!(two.iter().all(|size| (size - 5.0).abs() < 1e-5), "{two:?}");
}

#[test]
fn points_at_one_place_have_a_size() {
    let smallest = SMALLEST_SQUARED_DISTANCE.sqrt();
    for count in [2, 4, 5_000] {
        let found = sizes(&grey(vec![[0.3, -0.2, 1.5]; count]));
        assert_eq!(found.len(), count);
        assert!(found.iter().all(|size| (size - smallest).abs() < 1e-8), "{count} points");
    }
    // Many points at two places on one plane are the hardest case for a tree that splits at medians.
    let places: Vec<[f32; 3]> = (0..5_000).map(|i| [(i % 2) as f32, 0.0, 0.0]).collect();
    assert!(sizes(&grey(places)).iter().all(|size| (size - smallest).abs() < 1e-8));
}

#[test]
fn of_points_at_one_place_the_first_remains() {
    let places =
        [[1.0, 2.0, 3.0], [1.000_001, 2.0, 3.0], [-4.0, 0.0, 0.0], [1.0, 2.0, 3.0], [1.1, 2.0, 3.0], [4.0, 0.0, 0.0]];
    let mut cloud = grey(places.to_vec());
    cloud.colours = (0..6).map(|i| [i; 3]).collect();
    let found = distinct(&cloud);
    assert_eq!(found.positions, [places[0], places[2], places[4], places[5]]);
    assert_eq!(found.colours, [[0; 3], [2; 3], [4; 3], [5; 3]]);
    // Whatever lies between the borders of cells.
    let mut rng = rng(4);
    let mut positions: Vec<[f32; 3]> =
        (0..4_000).map(|_| std::array::from_fn(|_| rng.random_range(-3.0..3.0))).collect();
    let once = distinct(&grey(positions.clone())).positions.len();
    assert!(once > 3_990, "{once}");
    positions.extend(positions.clone().iter().map(|p| p.map(|x| x + 1e-6)));
    assert_eq!(distinct(&grey(positions)).positions.len(), once);
    // One place has no size, nor do a few bad rows give it one.
    assert_eq!(distinct(&grey(vec![[0.3; 3]; 500])).positions.len(), 1);
    assert_eq!(distinct(&grey(vec![[0.0; 3], [-0.0; 3], [f32::NAN; 3], [1e-30; 3]])).positions.len(), 2);
    assert_eq!(distinct(&PointCloud::default()), PointCloud::default());
}

#[test]
fn a_point_shows_its_colour_and_opacity() {
    let colours = vec![[0, 128, 255], [255, 1, 77], [3, 200, 254]];
    let positions = vec![[0.1, 0.2, 1.0], [-0.3, 0.0, 2.0], [0.0, 0.4, 3.0]];
    let rows = from_points(&PointCloud { positions: positions.clone(), colours: colours.clone() });
    assert_eq!((rows.sh_degree, &rows.means), (0, &positions));
    let device = Device::flex();
    let scene = Gaussians::from_rows(&rows, &device).unwrap();
    let camera = Camera::new(Intrinsics::centred(32, 24, 30.0), &DAffine3::IDENTITY, &device);
    let shown = values_of(evaluate_sh(&scene.sh_blocks().remove(0), &scene.means(), &camera).unwrap());
    for (shown, colour) in shown.iter().zip(colours.as_flattened()) {
        // Black would be clamped and have no gradient.
        let expected = f32::from(*colour).max(0.5) / 255.0;
        assert!((shown - expected).abs() < 1e-6, "{shown} instead of {colour}/255");
    }
    assert!(values_of(scene.opacities()).iter().all(|opacity| (opacity - 0.1).abs() < 1e-6));
}

#[test]
fn thinning_takes_every_kth_point_and_never_too_many() {
    let mut cloud = grey((0..10).map(|i| [i as f32, 0.0, 0.0]).collect());
    cloud.colours = (0..10).map(|i| [i; 3]).collect();
    for most in 1..=12 {
        let kept = thinned(&cloud, most);
        assert!((1..=most).contains(&kept.positions.len()), "{} of at most {most}", kept.positions.len());
        let positions: Vec<f32> = kept.positions.iter().map(|position| position[0]).collect();
        let colours: Vec<f32> = kept.colours.iter().map(|colour| f32::from(colour[0])).collect();
        assert_eq!(positions, colours);
    }
    assert_eq!(thinned(&cloud, 3).positions.iter().map(|position| position[0]).collect::<Vec<_>>(), [0.0, 4.0, 8.0]);
    assert_eq!(thinned(&cloud, 10), cloud);
    assert_eq!(thinned(&PointCloud::default(), 5), PointCloud::default());
}

#[test]
fn ordered_points_keep_their_colours() {
    let mut cloud = grey((0..10_u8).map(|i| [f32::from(i * 7 % 10), 0.0, 0.0]).collect());
    cloud.colours = cloud.positions.iter().map(|position| [position[0] as u8; 3]).collect();
    let ordered = ordered(&cloud);
    assert_eq!(ordered.positions, (0..10_u8).map(|i| [f32::from(i), 0.0, 0.0]).collect::<Vec<_>>());
    assert_eq!(ordered.colours, (0..10).map(|i| [i; 3]).collect::<Vec<_>>());
    assert_eq!(super::ordered(&PointCloud::default()), PointCloud::default());
}

/// A landscape format with the principal point off the centre.
fn intrinsics() -> Intrinsics {
    Intrinsics::pinhole(64, 24, [60.0, 55.0], [25.0, 10.0])
}

/// A camera at `centre` that looks along `forward`.
fn camera(centre: DVec3, forward: DVec3) -> (Intrinsics, DAffine3) {
    let z = forward.normalize();
    let x = DVec3::Y.cross(z).normalize();
    let cam_from_world = DMat3::from_cols(x, z.cross(x), z).transpose();
    (intrinsics(), DAffine3::from_mat3_translation(cam_from_world, -(cam_from_world * centre)))
}

/// Depth of a point in a camera that shows it. Positions are rounded to f32, so a point may lie slightly outside.
fn depth_in((size, pose): &(Intrinsics, DAffine3), position: &[f32; 3]) -> Option<f64> {
    let at = pose.transform_point3(Vec3::from(*position).as_dvec3());
    let x = size.fx * at.x / at.z + size.cx;
    let y = size.fy * at.y / at.z + size.cy;
    let inside = |px: f64, side: usize| px > -1e-3 && px < side as f64 + 1e-3;
    (at.z > 0.0 && inside(x, size.width) && inside(y, size.height)).then_some(at.z)
}

/// Asserts that every point is shown by a camera at a depth within `depths`, and returns the points.
#[track_caller]
fn assert_shown(cameras: &[(Intrinsics, DAffine3)], depths: [f64; 2]) -> PointCloud {
    let points = random_points(cameras, 400, &mut rng(3));
    assert_eq!((points.positions.len(), points.colours.len()), (400, 400));
    for position in &points.positions {
        let mut shown = cameras.iter().filter_map(|camera| depth_in(camera, position));
        assert!(shown.any(|depth| depth >= depths[0] && depth <= depths[1]), "{position:?}");
    }
    points
}

#[test]
fn random_points_lie_where_the_cameras_look() {
    let target = DVec3::new(20.0, -3.0, 7.0);
    let ring: Vec<_> = (0..8)
        .map(|i| TAU * f64::from(i) / 8.0)
        .map(|angle| DVec3::new(4.0 * angle.cos(), 1.0, 4.0 * angle.sin()))
        .map(|offset| camera(target + offset, -offset))
        .collect();
    let distance = 17f64.sqrt();
    let points = assert_shown(&ring, [0.499 * distance, 1.501 * distance]);
    let mean = points.positions.iter().map(|&p| Vec3::from(p).as_dvec3()).sum::<DVec3>() / 400.0;
    assert!((mean - target).length() < 1.0, "{mean}");
    assert_eq!(points, random_points(&ring, 400, &mut rng(3)));
    assert_ne!(points, random_points(&ring, 400, &mut rng(4)));
    assert_eq!(random_points(&ring, 0, &mut rng(3)), PointCloud::default());
    assert_eq!(random_points(&[], 400, &mut rng(3)), PointCloud::default());
}

#[test]
fn cameras_without_a_common_focus_get_points_all_the_same() {
    let (forward, aside) = (DVec3::new(0.3, 0.1, 1.0), DVec3::new(1.0, 0.0, -0.3));
    assert_shown(&[camera(DVec3::splat(9.0), forward)], [0.499, 1.501]);
    let parallel: Vec<_> = (0..5).map(|i| camera(aside * f64::from(i), forward)).collect();
    assert_shown(&parallel, [0.4, 6.0]);
    let facing = [camera(DVec3::Z * -5.0, DVec3::Z), camera(DVec3::Z * 5.0, -DVec3::Z)];
    assert_shown(&facing, [2.4, 7.6]);
}

#[test]
fn a_panorama_gets_points_around_it() {
    // All optical axes meet at the cameras themselves, where nothing can be seen.
    let centre = DVec3::new(2.0, -1.0, 0.5);
    let around = |i: i32| TAU * f64::from(i) / 6.0;
    let cameras: Vec<_> = (0..6).map(|i| camera(centre, DVec3::new(around(i).cos(), 0.2, around(i).sin()))).collect();
    assert_shown(&cameras, [0.499, 1.501]);
}

#[test]
fn a_small_cloud_begins_as_a_large_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut positions: Vec<[f32; 3]> = (0..50).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect();
    // Several points at one place, whose distances are zero.
    positions.extend([positions[0]; 3]);
    let cloud = |scale: f32| PointCloud {
        positions: positions.iter().map(|position| position.map(|c| c * scale)).collect(),
        colours: vec![[0; 3]; positions.len()],
    };
    // A power of two, so that nothing is rounded.
    let scale = 2.0_f32.powi(-10);
    let (large, small) = (from_points(&cloud(0.25)).log_scales, from_points(&cloud(0.25 * scale)).log_scales);
    for (i, (large, small)) in large.iter().zip(&small).enumerate() {
        assert!((large[0] + scale.ln() - small[0]).abs() < 1e-5, "{i}: {} and {}", large[0], small[0]);
    }
    // The original's floor still holds for clouds of a unit and more.
    let at_one_place = from_points(&cloud(4.0)).log_scales[0][0];
    assert!((at_one_place - SMALLEST_SQUARED_DISTANCE.sqrt().ln()).abs() < 1e-6, "{at_one_place}");
}

#[test]
fn photographs_are_searched_where_points_are_few() {
    for (points, pixels, expected) in [
        (0, 10_000_000, 15_000),
        (4_443, 10_000_000, 10_557),
        (5_000, 10_000_000, 0),
        (0, 50_000, 1_000),
        (333, 50_000, 667),
        (334, 50_000, 0),
        (0, 49, 0),
    ] {
        assert_eq!(missing(points, pixels), expected, "{points} points, {pixels} px");
    }
}
