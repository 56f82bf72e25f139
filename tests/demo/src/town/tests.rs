use std::fs;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_model::capture::Capture;

use super::super::geometry::Ray;
use super::*;
use crate as demo;

const SMALL: DemoOptions = DemoOptions { width: 48, height: 36, views: 40, points: 400, ..DemoOptions::TOWN };

/// The grid finds what a search through all things finds.
#[test]
fn the_grid_misses_nothing() {
    let things = layout::things(&SMALL);
    assert!(things.len() > 400, "{}", things.len());
    let grid = grid::Grid::new(things.clone());
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut met = 0;
    for i in 0..20_000 {
        let mut draw = |low: f64, high: f64| random.random_range(low..high);
        let origin = DVec3::new(draw(-260.0, 260.0), draw(-260.0, 260.0), draw(0.5, 80.0));
        let slope = draw(-0.6, 0.2);
        let mut direction = DVec3::new(draw(-1.0, 1.0), draw(-1.0, 1.0), slope);
        // Every tenth ray is parallel to an axis.
        if i % 10 == 0 {
            direction = if i % 20 == 0 { DVec3::X } else { DVec3::NEG_Y };
        }
        let ray = Ray { origin, direction: direction.normalize() };
        let expected = (things.iter().enumerate())
            .filter_map(|(i, thing)| Some((i, thing.hit(&ray)?)))
            .min_by(|(_, a), (_, b)| a.distance.total_cmp(&b.distance));
        let found = grid.hit(&ray);
        assert_eq!(found.map(|(_, hit)| hit.distance), expected.map(|(_, hit)| hit.distance), "{ray:?}");
        met += usize::from(found.is_some());
    }
    assert!(met > 5_000 && met < 19_000, "{met}");
}

#[test]
fn no_camera_stands_in_a_house() {
    let things = layout::things(&DemoOptions::TOWN);
    for (i, camera) in photographs::cameras(&DemoOptions::TOWN).iter().enumerate() {
        let at = camera.centre_world;
        let inside = things.iter().any(|thing| at.cmpgt(thing.low).all() && at.cmplt(thing.high).all());
        assert!(!inside && at.truncate().abs().max_element() < HALF + HALF_STREET, "camera {i} at {at}");
    }
}

/// Equal options give the same bytes, another seed another town, and the model says where its photographs show its points.
#[test]
fn the_capture_is_exact_and_repeatable() {
    let folder = tempfile::tempdir().unwrap();
    let [first, again, other] = ["first", "again", "other"].map(|name| folder.path().join(name));
    for (folder, seed) in [(&first, 0), (&again, 0), (&other, 1)] {
        demo::write(folder, &DemoOptions { seed, ..SMALL }).unwrap();
    }
    for file in ["images/0000.png", "images/0004.png", "sparse/0/images.bin", "sparse/0/points3D.bin"] {
        let of = |folder: &Path| fs::read(folder.join(file)).unwrap();
        assert!(of(&first) == of(&again), "{file}");
        assert!(of(&first) != of(&other), "{file}");
    }
    let capture = Capture::load(&first).unwrap();
    assert_eq!((capture.views.len(), capture.points.positions.len()), (SMALL.views, SMALL.points));
    let town = LitTown::new(layout::things(&SMALL));
    let cameras = photographs::cameras(&SMALL);
    let mut views = 0;
    for (point, position) in capture.points.positions.iter().enumerate() {
        let track = capture.tracks.of(point);
        assert!(track.len() >= 2);
        views += track.len();
        for observation in track {
            let ray = cameras[observation.view].ray_through(glam::Vec2::from(observation.at_px).as_dvec2());
            let met = town.hit(&ray).expect("a surface").position_world;
            // The pixel's position is rounded to f32, which a grazing ray magnifies.
            let strays = met.distance(glam::Vec3::from(*position).as_dvec3());
            assert!(strays < 0.5, "point {point} at {position:?} is at {met}");
        }
    }
    // Houses hide most of the town from the streets.
    let share = views as f64 / (SMALL.points * SMALL.views) as f64;
    assert!(share > 0.05 && share < 0.4, "{share}");
}

#[test]
fn a_town_goes_with_no_effect() {
    let error = demo::write(Path::new("none"), &DemoOptions { masks: true, ..SMALL }).unwrap_err().to_string();
    assert!(error.contains("town") && error.contains("masks"), "{error}");
}
