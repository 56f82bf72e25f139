//! Tests of photographs with motion blur or a rolling shutter.

use glam::DVec3;

use super::effects::{FULL, scene};
use super::*;

/// Compares with the average of sixteen sharp photographs along the way.
#[test]
fn motion_is_an_average_along_a_straight_way() {
    let options = DemoOptions { motion: true, ..FULL };
    let scene = scene(&options);
    let shots = shots(&DemoOptions { views: 48, ..options });
    let blurred: Vec<usize> = (0..48).filter(|&view| shots[view].is_blurred()).collect();
    assert_eq!(blurred.len(), 17, "two fifths of 42: {blurred:?}");
    assert_eq!(blurred[..4], [2, 4, 7, 10]);
    let shot = &shots[2];
    // During the exposure, the subject moves by 12 px.
    let subject = shot.camera.ray_through(DVec2::new(120.0, 90.0)).at(shot.camera.subject_distance);
    let at = |time: f64| shot.camera_at(0.0, time);
    let [start, end] = [at(-0.5), at(0.5)].map(|camera| camera.project(subject).unwrap());
    assert!((start.distance(end) - 12.0).abs() < 0.2, "{start} {end}");
    assert!((0.5 * (start + end)).distance(DVec2::new(120.0, 90.0)) < 0.1, "the pose is the middle one");
    let direct = (shot.camera.centre_world - at(-0.5).centre_world) - (at(0.5).centre_world - shot.camera.centre_world);
    assert!(direct.length() < 1e-12, "straight and steady");
    let sharp: Vec<Shot> = (0..16).map(|i| Shot::plain(at((f64::from(i) + 0.5) / 16.0 - 0.5))).collect();
    let picture = render(&scene, shot).into_rgb8();
    let still = render(&scene, &Shot::plain(shot.camera)).into_rgb8();
    let (mut error, mut blur, mut count) = (0.0, 0.0, 0);
    for (x, y) in (8..170).step_by(9).flat_map(|y| (5..235).step_by(9).map(move |x| (x, y))) {
        let light: DVec3 = sharp.iter().map(|shot| nine(&scene, shot, DVec2::new(x.into(), y.into()))).sum();
        let expected = 255.0 * display(light / (9.0 * sharp.len() as f64)).y;
        error += (expected - f64::from(picture.get_pixel(x, y)[1])).abs();
        blur += (expected - f64::from(still.get_pixel(x, y)[1])).abs();
        count += 1;
    }
    let [error, blur] = [error, blur].map(|sum| sum / f64::from(count));
    assert!(error < 1.0 && blur > 5.0 * error, "off by {error} levels, {blur} without motion");
}

/// The sum of the light of nine rays of a sharp pixel.
fn nine(scene: &LitScene, shot: &Shot, corner_px: DVec2) -> DVec3 {
    let place = |i: u32| (DVec2::new(f64::from(i % 3), f64::from(i / 3)) + 0.5) / 3.0;
    (0..9).map(|i| scene.along(&shot.camera.ray_through(corner_px + place(i)))).sum()
}

/// Each row equals that row of a still camera at the moving camera's position at that time.
#[test]
fn rows_are_read_one_after_the_other() {
    let options = DemoOptions { rolling: true, ..FULL };
    let scene = scene(&options);
    let shot = &shots(&options)[1];
    let subject = shot.camera.ray_through(DVec2::new(120.0, 90.0)).at(shot.camera.subject_distance);
    let [first, last] = [0.0, 180.0].map(|row| shot.camera_at(row, 0.0));
    let [first_px, last_px] = [first, last].map(|camera| camera.project(subject).unwrap());
    assert!((first_px.distance(last_px) - 12.0).abs() < 0.2, "{first_px} {last_px}");
    let middle = shot.camera_at(90.0, 0.0);
    assert!(middle.cam_from_world.abs_diff_eq(shot.camera.cam_from_world, 1e-12));
    let picture = render(&scene, shot).into_rgb8();
    let (mut error, mut moved) = (0.0, 0.0);
    let rows = [3, 20, 70, 120, 150, 177];
    for y in rows {
        let still = Shot::plain(shot.camera_at(f64::from(y) + 0.5, 0.0));
        for x in (0..240).step_by(4) {
            let expected = |shot: &Shot| 255.0 * display(nine(&scene, shot, DVec2::new(x.into(), y.into())) / 9.0).y;
            let found = f64::from(picture.get_pixel(x, y)[1]);
            error += (expected(&still) - found).abs() / 360.0;
            moved += (expected(&Shot::plain(shot.camera)) - found).abs() / 360.0;
        }
    }
    assert!(error < 0.7 && moved > 5.0 * error, "off by {error} levels, {moved} without motion");
}
