use rand::RngExt;

use super::*;
use crate::capture::testing::assert_says;

const METRES_PER_UNIT: f64 = 3.7;

/// Cameras on a walk around a square of `size_m`, near Sydney, with noise of `noise_m` per axis and `wrong` positions elsewhere.
fn walk(photographs: usize, size_m: f64, noise_m: f64, wrong: usize) -> Vec<(DVec3, Gps)> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 2.1);
    let mut noise = |size: f64| -> f64 {
        // A sum of twelve uniform numbers is close to normal.
        size * ((0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0)
    };
    (0..photographs)
        .map(|i| {
            let angle = i as f64 / photographs as f64 * std::f64::consts::TAU;
            let east_north_up =
                DVec3::new(0.5 * size_m * angle.cos(), 0.5 * size_m * angle.sin(), 2.0 + (5.0 * angle).sin());
            let centre = turn * (east_north_up / METRES_PER_UNIT) + DVec3::new(4.0, -1.0, 2.0);
            let [x, y, z] = (east_north_up + DVec3::new(noise(noise_m), noise(noise_m), noise(noise_m))).to_array();
            let away = if i < wrong { 300.0 } else { 0.0 };
            let latitude_deg = -33.857 + (y + away) / 110_909.0;
            let longitude_deg = 151.215 + x / (111_320.0 * (33.857f64).to_radians().cos());
            (centre, Gps { latitude_deg, longitude_deg, altitude_m: Some(z) })
        })
        .collect()
}

#[track_caller]
fn assert_scale(pairs: &[(DVec3, Gps)], within: f64) {
    let scale = fitted(pairs, pairs.len()).unwrap();
    assert!((scale.metres_per_unit / METRES_PER_UNIT - 1.0).abs() < within, "{scale:?}");
}

#[test]
fn cameras_fit_their_places() {
    // The degree's length in metres above is rounded, and the Earth is not flat.
    assert_scale(&walk(30, 80.0, 0.0, 0), 2e-3);
    assert_scale(&walk(60, 80.0, 2.0, 0), 0.03);
    assert_scale(&walk(4, 80.0, 0.0, 0), 2e-3);
}

#[test]
fn a_third_of_wrong_positions_changes_little() {
    assert_scale(&walk(60, 80.0, 1.0, 20), 0.03);
}

#[test]
fn heights_are_left_out_unless_all_have_one() {
    let mut pairs = walk(30, 80.0, 0.0, 0);
    pairs[3].1.altitude_m = None;
    // Without heights the cameras' own, of ±1 m, count as noise.
    assert_scale(&pairs, 0.01);
}

#[test]
fn the_stated_deviation_is_that_of_the_noise() {
    let scale = fitted(&walk(60, 80.0, 2.0, 0), 60).unwrap();
    // σ / (radius · √n) = 2 / (40 · √60).
    let expected = 2.0 / (40.0 * 60f64.sqrt());
    let found = scale.relative_deviation.unwrap();
    assert!((0.7..1.3).contains(&(found / expected)), "{found}, expected {expected}");
}

#[test]
fn noise_without_a_walk_is_refused() {
    let message = fitted(&walk(20, 3.0, 5.0, 0), 20).unwrap_err().to_string();
    assert_says(&message, &["20 photographs", "expected ±10%", "scale.json"]);
    let at_one_place = walk(20, 0.0, 0.0, 0).iter().map(|&(_, gps)| (DVec3::ZERO, gps)).collect::<Vec<_>>();
    assert!(fitted(&at_one_place, 20).is_err());
    let message = fitted(&walk(3, 80.0, 0.0, 0), 9).unwrap_err().to_string();
    assert_says(&message, &["3 of 9", "at least 4", "location"]);
}

#[test]
fn the_best_rotation_is_found() {
    for rotation in [DQuat::IDENTITY, DQuat::from_rotation_x(3.0), DQuat::from_xyzw(0.5, -0.5, 0.5, -0.5)] {
        let points = [DVec3::X, DVec3::new(0.2, 1.0, 0.0), DVec3::new(0.3, -0.1, 2.0)];
        let products = points.iter().fold(DMat3::ZERO, |sum, &a| {
            let b = rotation * a;
            sum + DMat3::from_cols(b * a.x, b * a.y, b * a.z)
        });
        let found = best_rotation(products);
        assert!(found.dot(rotation).abs() > 1.0 - 1e-12, "{found} is not {rotation}");
    }
}
