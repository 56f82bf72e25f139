//! The sparse points of the demo capture: what a structure-from-motion program would have found, without its errors.

use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::DemoOptions;
use super::camera::DemoCamera;
use super::light::{LitScene, display};
use super::picture::to_bytes;
use crate::capture::{Observation, PointCloud, Tracks};

/// Two positions on a surface are the same if their distances to a camera differ by no more than this share.
const SAME: f64 = 1e-6;

/// Points on surfaces that at least two cameras see, with the colour of their matte light, and where each camera sees them.
///
/// The places are drawn from the pictures themselves, camera after camera, so that the density of points follows what
/// the pictures show.
pub(super) fn sample(scene: &LitScene, cameras: &[DemoCamera], options: &DemoOptions) -> (PointCloud, Tracks) {
    // Another stream than the cameras', which draw from stream 0 of the same seed.
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    random.set_stream(1);
    let (mut cloud, mut tracks) = (PointCloud::default(), Tracks::default());
    // Every try succeeds unless one camera alone sees the place; a bound keeps odd options from looping for ever.
    for attempt in 0..8 * options.points {
        if cloud.positions.len() == options.points {
            break;
        }
        let camera = &cameras[attempt % cameras.len()];
        let share = DVec2::new(random.random(), random.random());
        let size_px = DVec2::new(camera.intrinsics.width as f64, camera.intrinsics.height as f64);
        let Some(point) = scene.scene.hit(&camera.ray_through(share * size_px)) else { continue };
        let sight = |(view, camera): (usize, &DemoCamera)| {
            let at_px = sight(scene, camera, point.position_world)?.as_vec2().to_array();
            Some(Observation { view, at_px })
        };
        let sights: Vec<Observation> = cameras.iter().enumerate().filter_map(sight).collect();
        if sights.len() >= 2 {
            // Nobody measured an error.
            tracks.push(sights.into_iter().map(Some), -1.0);
            cloud.positions.push(point.position_world.as_vec3().to_array());
            cloud.colours.push(to_bytes(display(scene.matte(&point))));
        }
    }
    (cloud, tracks)
}

/// Where a camera's picture shows a point of a surface, px, if it lies within and nothing stands before it.
pub(super) fn sight(scene: &LitScene, camera: &DemoCamera, point_world: DVec3) -> Option<DVec2> {
    let at_px = camera.project(point_world)?;
    let distance = camera.centre_world.distance(point_world);
    let first = scene.scene.hit(&camera.ray_through(at_px))?;
    ((first.distance - distance).abs() <= SAME * distance).then_some(at_px)
}
