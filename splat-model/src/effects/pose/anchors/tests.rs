use glam::DQuat;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use splat_demo::{self as demo, DemoOptions};

/// Points in front of a camera, with noise on the directions, and the camera's pose.
fn observations(count: usize, noise: f64) -> (Anchors, DAffine3) {
    let pose = DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.7), DVec3::new(0.3, -0.2, 2.0));
    let spread = |i: usize, by: f64| (by * i as f64).sin();
    let mut anchors = Anchors::default();
    for i in 0..count {
        let cam = DVec3::new(1.5 * spread(i, 1.3), 1.2 * spread(i, 2.1), 4.0 + 2.0 * spread(i, 0.7));
        let seen = cam.normalize() + noise * DVec3::new(spread(i, 5.1), spread(i, 7.7), 0.0);
        anchors.0.push((pose.inverse().transform_point3(cam), seen.normalize()));
    }
    (anchors, pose)
}

fn wrong(pose: &DAffine3) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(0.1, -0.05, 0.08)) * DAffine3::from_axis_angle(DVec3::X, 0.05) * *pose
}

#[test]
fn a_camera_is_put_where_its_points_say() {
    let (anchors, pose) = observations(40, 0.0);
    assert!(anchors.resected(&wrong(&pose)).abs_diff_eq(pose, 1e-9));
    // A fifth of the directions is wrong.
    let (mut anchors, pose) = observations(100, 1e-4);
    for i in (0..100).step_by(5) {
        anchors.0[i].1 = (anchors.0[i].1 + DVec3::new(0.2, 0.1, 0.0)).normalize();
    }
    let found = anchors.resected(&wrong(&pose));
    assert!(found.abs_diff_eq(pose, 3e-3), "{found:?} instead of {pose:?}");
    // Too few points.
    let (few, pose) = observations(FEWEST - 1, 0.0);
    assert_eq!(few.resected(&wrong(&pose)), wrong(&pose));
    assert!(few.on_device(&Device::flex()).is_none());
}

#[test]
fn columns_are_the_derivative_of_directions() {
    let cam = DVec3::new(0.7, -0.4, 2.5);
    let step = 1e-6;
    for (i, column) in columns(cam).into_iter().enumerate() {
        let axis = [DVec3::X, DVec3::Y, DVec3::Z][i % 3] * step;
        let moved = |sign: f64| if i < 3 { cam + sign * axis.cross(cam) } else { cam + sign * axis };
        let expected = (moved(1.0).normalize() - moved(-1.0).normalize()) / (2.0 * step);
        assert!(column.distance(expected) < 1e-9, "{i}: {column} instead of {expected}");
    }
}

#[test]
fn the_pull_is_an_angle_and_vanishes_at_the_right_pose() {
    let device = Device::flex();
    let (anchors, pose) = observations(40, 0.0);
    let on_device = anchors.on_device(&device).unwrap();
    let pull = |pose: &DAffine3| {
        let rows: Vec<f32> = (0..3)
            .flat_map(|i| [pose.x_axis[i], pose.y_axis[i], pose.z_axis[i], pose.translation[i]])
            .map(|value| value as f32)
            .collect();
        let pose = Tensor::<2>::from_data(TensorData::new(rows, [3, 4]), &device);
        penalty(&on_device, &Tensor::from_inner(pose)).into_scalar::<f32>()
    };
    assert!(pull(&pose).abs() < 1e-6);
    // Rotated about the viewing axis by 0.03 rad: each direction moves by that times its distance from the axis.
    let turned = DAffine3::from_mat3(rotation(DVec3::new(0.0, 0.0, 0.03))) * pose;
    let miss = |(_, direction): &(DVec3, DVec3)| (0.03 * direction.truncate().length()).hypot(ROBUST_RAD) - ROBUST_RAD;
    let expected = anchors.0.iter().map(miss).sum::<f64>() / 40.0;
    assert!((f64::from(pull(&turned)) - expected).abs() < 0.01 * expected);
}

/// On the demo capture, whose tracks are exact, each photograph has the directions of its own points.
#[test]
fn tracks_are_those_of_the_photographs_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 64, height: 48, views: 5, points: 200, lens: true, ..DemoOptions::PLAIN };
    demo::write(folder.path(), &options).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    let views = [4, 1];
    let anchors = from_tracks(&capture, &views);
    assert_eq!(anchors.len(), 2);
    for (anchors, view) in anchors.iter().zip(views) {
        let of_view =
            |point: usize| capture.tracks.of(point).iter().filter(|observation| observation.view == view).count();
        assert_eq!(anchors.0.len(), (0..200).map(of_view).sum::<usize>());
        assert!(anchors.0.len() > 30);
        for (point, direction) in &anchors.0 {
            let cam = capture.views[view].cam_from_world.transform_point3(*point);
            assert!(cam.normalize().distance(*direction) < 1e-5, "{cam} {direction}");
        }
    }
}

/// A point at the camera's centre has no direction and changes nothing.
#[test]
fn a_point_at_the_camera_is_passed_over() {
    let (anchors, _) = observations(40, 0.0);
    let mut with = anchors.clone();
    with.0.push((DVec3::ZERO, DVec3::Z));
    let step = anchors.step(&DAffine3::IDENTITY);
    assert!(step.is_some() && with.step(&DAffine3::IDENTITY) == step);
}

/// However little the directions fit the points, no camera is moved to a pose that fits worse.
#[test]
fn a_camera_is_never_worse_off() {
    for seed in 0..200 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut vector = || DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
        let mut anchors = Anchors::default();
        // Every other camera is closer to its points than the Gauss-Newton steps allow.
        let size = if seed % 2 == 0 { 1.0 } else { 0.03 };
        for _ in 0..FEWEST {
            anchors.0.push((size * vector(), vector().normalize()));
        }
        let start = DAffine3::from_translation(0.1 * vector());
        let found = anchors.resected(&start);
        assert!(found.is_finite() && anchors.cost(&found) <= anchors.cost(&start), "{seed}");
    }
}

#[test]
fn equations_are_solved_where_they_can_be() {
    let gram = [[4.0, 2.0, 0.0], [2.0, 5.0, -1.0], [0.0, -1.0, 3.0]];
    let expected = [0.5, -2.0, 7.0];
    let moment = gram.map(|row| row.iter().zip(expected).map(|(a, b)| a * b).sum());
    let found = solve(gram, moment).unwrap();
    assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12), "{found:?}");
    for singular in [[[1.0, 2.0], [2.0, 4.0]], [[0.0; 2]; 2], [[f64::NAN, 0.0], [0.0, 1.0]]] {
        assert_eq!(solve(singular, [1.0, 2.0]), None);
    }
}
