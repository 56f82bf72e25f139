//! The sparse points of the demo capture: those of a structure-from-motion program, without its errors.

use glam::DVec2;
use rand::RngExt;

use super::DemoOptions;
use super::light::{LitScene, display};
use super::options::Stream;
use super::picture::to_bytes;
use super::shot::Shot;
use splat_model::capture::{Observation, PointCloud, Tracks};

/// Two positions on a surface count as the same if their distances to a camera differ by at most this share.
const SAME: f64 = 1e-6;

/// Points on surfaces that at least two photographs show, with the colour of their matte light and their observations.
///
/// Positions are drawn from the pictures in turn, so that the density of points follows what
/// the pictures show.
pub(super) fn sample(scene: &LitScene, shots: &[Shot], options: &DemoOptions) -> (PointCloud, Tracks) {
    let mut random = options.random(Stream::Points);
    let (mut cloud, mut tracks) = (PointCloud::default(), Tracks::default());
    // A try fails only where a single camera sees the position; the bound keeps odd options from looping for ever.
    for attempt in 0..8 * options.points {
        if cloud.positions.len() == options.points {
            break;
        }
        let shot = &shots[attempt % shots.len()];
        let share = DVec2::new(random.random(), random.random());
        let size_px = DVec2::new(shot.camera.intrinsics.width as f64, shot.camera.intrinsics.height as f64);
        let Some(point) = scene.scene.hit(&sharp_ray(shot, share * size_px)) else { continue };
        if scene.scene.is_clear_sky(&point, options) {
            continue;
        }
        if shot.transparent && scene.scene.is_surroundings(&point) {
            continue;
        }
        let observation = |(view, shot): (usize, &Shot)| {
            let at_px = observation(scene, shot, point.position_world)?.as_vec2().to_array();
            Some(Observation { view, at_px })
        };
        let observations: Vec<Observation> = shots.iter().enumerate().filter_map(observation).collect();
        if observations.len() >= 2 {
            // The error is unmeasured.
            tracks.push(observations, -1.0);
            cloud.positions.push(point.position_world.as_vec3().to_array());
            cloud.colours.push(to_bytes(display(scene.matte(&point))));
        }
    }
    (cloud, tracks)
}

/// The position at which a photograph shows a surface point, px, if it lies within the picture and nothing occludes it.
pub(super) fn observation(scene: &LitScene, shot: &Shot, point_world: glam::DVec3) -> Option<DVec2> {
    let (at_px, camera) = shot.project(point_world)?;
    let distance = camera.centre_world.distance(point_world);
    let first = scene.scene.hit(&sharp_ray(shot, at_px))?;
    let seen = (first.distance - distance).abs() <= SAME * distance && shot.disc_at(at_px).is_none();
    seen.then_some(at_px)
}

/// The central ray of those that end at a position of the picture.
fn sharp_ray(shot: &Shot, at_px: DVec2) -> super::geometry::Ray {
    shot.ray(at_px, 0.0)
}
