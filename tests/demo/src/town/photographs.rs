//! The town's cameras, photographs and sparse points.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};
use image::RgbImage;
use rand::RngExt;
use rayon::prelude::*;
use splat_op::Intrinsics;

use super::super::DemoOptions;
use super::super::camera::DemoCamera;
use super::super::light::display;
use super::super::options::Stream;
use super::super::picture::to_bytes;
use super::light::LitTown;
use super::{BETWEEN_STREETS, HALF};
use splat_model::capture::{Observation, PointCloud, Tracks};

/// Horizontal field of view.
const FOV_X_DEG: f64 = 75.0;

/// Every so many photographs, the last of them is taken from above.
const ABOVE_EVERY: usize = 5;

/// Directions of successive photographs in a street, relative to it: ahead and back, to its left and right side.
const TURNS_DEG: [f64; 4] = [28.0, -28.0, 152.0, -152.0];

/// Samples along each side of a pixel.
const SAMPLES: usize = 2;

/// Two positions count as the same if their distances to a camera differ by at most this share.
const SAME: f64 = 1e-6;

/// The cameras. Every [`ABOVE_EVERY`]th looks down from above the roofs. The number is prime to that of held-out photographs, so
/// that those are of all kinds.
pub(super) fn cameras(options: &DemoOptions) -> Vec<DemoCamera> {
    let mut random = options.random(Stream::Cameras);
    let focal_px = 0.5 * options.width as f64 / (0.5 * FOV_X_DEG).to_radians().tan();
    let intrinsics = Intrinsics::centred(options.width, options.height, focal_px);
    let count_above = options.views / ABOVE_EVERY;
    let count_below = options.views - count_above;
    let (mut below, mut above) = (0, 0);
    (0..options.views)
        .map(|i| {
            let mut jitter = |size: f64| size * (2.0 * random.random::<f64>() - 1.0);
            let jitters = DVec3::new(jitter(1.0), jitter(1.0), jitter(1.0));
            let (centre_world, target_world) = if i % ABOVE_EVERY == ABOVE_EVERY - 1 {
                above += 1;
                from_above(above - 1, jitters)
            } else {
                below += 1;
                in_street(below - 1, count_below, jitters)
            };
            DemoCamera::looking(intrinsics, centre_world, target_world)
        })
        .collect()
}

/// Centre and target of one of `count` cameras that are spread evenly along all streets.
fn in_street(i: usize, count: usize, jitters: DVec3) -> (DVec3, DVec3) {
    let streets = (2.0 * HALF / BETWEEN_STREETS) as usize + 1;
    let along = (i as f64 + 0.5) / count as f64 * (2 * streets) as f64;
    // Streets along x, then along y.
    let (street, share) = (along as usize, along.fract());
    let middle = BETWEEN_STREETS * (street % streets) as f64 - HALF;
    let (ahead, left) = if street < streets { (DVec2::X, DVec2::Y) } else { (DVec2::Y, DVec2::X) };
    let at = (2.0 * share - 1.0) * HALF * ahead + (middle + 2.5 * jitters.x) * left;
    let turn = TURNS_DEG[i % TURNS_DEG.len()] + 6.0 * jitters.y;
    let direction = turn.to_radians().cos() * ahead + turn.to_radians().sin() * left;
    let centre_world = at.extend(2.2 + 0.5 * jitters.z);
    (centre_world, centre_world + (10.0 * direction).extend(0.8))
}

/// Centre and target of a camera above the roofs. Additive recurrence with the plastic number spreads them evenly (Roberts 2018).
fn from_above(i: usize, jitters: DVec3) -> (DVec3, DVec3) {
    let share = DVec2::new(0.754_877_666_246_693 * i as f64 + 0.5, 0.569_840_290_998_053 * i as f64 + 0.5).fract_gl();
    let at = (2.0 * share - 1.0) * (HALF - 15.0);
    let azimuth = TAU * (0.618_033_988_749_895 * i as f64).fract();
    let target = at + 45.0 * DVec2::from_angle(azimuth);
    (at.extend(55.0 + 8.0 * jitters.z), target.extend(4.0))
}

/// Photographs the town, its rows in parallel. The result does not depend on the number of threads.
pub(super) fn render(town: &LitTown, camera: &DemoCamera) -> RgbImage {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut bytes = vec![0; 3 * width * height];
    bytes.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let mut light = DVec3::ZERO;
            for i in 0..SAMPLES * SAMPLES {
                let place = (DVec2::new((i % SAMPLES) as f64, (i / SAMPLES) as f64) + 0.5) / SAMPLES as f64;
                light += town.along(&camera.ray_through(DVec2::new(x as f64, y as f64) + place));
            }
            pixel.copy_from_slice(&to_bytes(display(light / (SAMPLES * SAMPLES) as f64)));
        }
    });
    RgbImage::from_raw(width as u32, height as u32, bytes).expect("three bytes for each pixel")
}

/// Points on surfaces that at least two photographs show, with their observations. Positions are drawn from the photographs in
/// turn.
pub(super) fn sample(town: &LitTown, cameras: &[DemoCamera], options: &DemoOptions) -> (PointCloud, Tracks) {
    let mut random = options.random(Stream::Points);
    let (mut cloud, mut tracks) = (PointCloud::default(), Tracks::default());
    // A try fails where the sky or a single photograph shows the position; the bound keeps odd options from looping for ever.
    for attempt in 0..8 * options.points {
        if cloud.positions.len() == options.points {
            break;
        }
        let camera = &cameras[attempt % cameras.len()];
        let size_px = DVec2::new(camera.intrinsics.width as f64, camera.intrinsics.height as f64);
        let at_px = DVec2::new(random.random(), random.random()) * size_px;
        let Some(point) = town.hit(&camera.ray_through(at_px)) else { continue };
        let observation = |(view, camera): (usize, &DemoCamera)| {
            let at_px = camera.project(point.position_world).filter(|&at_px| camera.shows(at_px))?;
            let distance = camera.centre_world.distance(point.position_world);
            let first = town.hit(&camera.ray_through(at_px))?;
            let seen = (first.distance - distance).abs() <= SAME * distance;
            seen.then_some(Observation { view, at_px: at_px.as_vec2().to_array() })
        };
        let observations: Vec<Observation> = cameras.par_iter().enumerate().filter_map(observation).collect();
        if observations.len() >= 2 {
            // The error is unmeasured.
            tracks.push(observations, -1.0);
            cloud.positions.push(point.position_world.as_vec3().to_array());
            cloud.colours.push(to_bytes(display(town.matte(&point))));
        }
    }
    (cloud, tracks)
}
