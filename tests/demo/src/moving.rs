//! The still life with one thing that moves, photographed by one camera after the other.

use std::f64::consts::TAU;

use glam::DVec3;
use splat_model::capture::{Photo, PointCloud};

use super::light::LitScene;
use super::scene::DemoScene;
use super::shot::{Shot, shots};
use super::{DemoOptions, picture, points};

/// Radius of the circle that the thing describes around its place, scene units. A larger one leads through others.
const RADIUS: f64 = 0.25;

/// The still life at a time: the planet in its middle slides once around its place from 0 to 1.
fn at(options: &DemoOptions, time: f64) -> LitScene {
    let (sin, cos) = (TAU * time).sin_cos();
    let mut scene = DemoScene::still_life(options);
    scene.move_planet(RADIUS * DVec3::new(cos, sin, 0.0));
    LitScene::new(scene)
}

/// Photographs of a scene that moves, each with its time, 0 to 1, and points of the scene at time 0. The cameras are those of
/// the options; photograph `i` has the time `7 i / views`, modulo one, so that neighbours in space are far apart in time.
pub fn moving(options: &DemoOptions) -> (Vec<(Photo, f64)>, PointCloud) {
    let shots = shots(options);
    let photograph = |(i, shot): (usize, &Shot)| {
        let time = (7.0 * i as f64 / shots.len() as f64).fract();
        (photo(i, shot, &at(options, time)), time)
    };
    let photos = shots.iter().enumerate().map(photograph).collect();
    let (cloud, _) = points::sample(&at(options, 0.0), &shots, options);
    (photos, cloud)
}

fn photo(i: usize, shot: &Shot, scene: &LitScene) -> Photo {
    Photo {
        name: super::name(i),
        intrinsics: shot.camera.intrinsics,
        cam_from_world: shot.camera.cam_from_world,
        rgb: picture::render(scene, shot).to_rgb8().into_raw(),
        alpha: None,
        mask: None,
    }
}
