//! Where the demo's photographs are taken from: three rings around the still life.

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use splat_op::Intrinsics;

use super::DemoOptions;
use super::geometry::Ray;

/// Horizontal field of view.
const FOV_X_DEG: f64 = 50.0;

/// What the cameras look at, world frame (z up, the platform's top at z = 0).
pub(super) const CENTRE_WORLD: DVec3 = DVec3::new(0.0, 0.0, 0.32);

/// Elevation in degrees and distance in scene units of each ring.
const RINGS: [(f64, f64); 3] = [(13.0, 4.9), (29.0, 4.5), (50.0, 4.3)];

/// One photograph's camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct DemoCamera {
    pub intrinsics: Intrinsics,
    /// Rigid, OpenCV axes.
    pub cam_from_world: DAffine3,
    pub centre_world: DVec3,
}

impl DemoCamera {
    /// The ray through a position in the picture, px; world frame.
    pub fn ray_through(&self, at_px: DVec2) -> Ray {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        let direction_cam = DVec3::new((at_px.x - cx) / fx, (at_px.y - cy) / fy, 1.0);
        let world_from_cam = self.cam_from_world.matrix3.transpose();
        Ray { origin: self.centre_world, direction: (world_from_cam * direction_cam).normalize() }
    }

    /// Where a point shows, px, if it lies in front of the camera and within the picture.
    pub fn project(&self, point_world: DVec3) -> Option<DVec2> {
        let Intrinsics { fx, fy, cx, cy, width, height, .. } = self.intrinsics;
        let point_cam = self.cam_from_world.transform_point3(point_world);
        let at_px = DVec2::new(fx * point_cam.x / point_cam.z + cx, fy * point_cam.y / point_cam.z + cy);
        let within = at_px.cmpge(DVec2::ZERO).all() && at_px.cmplt(DVec2::new(width as f64, height as f64)).all();
        (point_cam.z > 0.0 && within).then_some(at_px)
    }
}

/// The cameras of a capture. Neighbours in the list stand on different rings, so that any regular choice of views for
/// testing sees all heights.
pub(super) fn cameras(options: &DemoOptions) -> Vec<DemoCamera> {
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    let focal_px = 0.5 * options.width as f64 / (0.5 * FOV_X_DEG).to_radians().tan();
    let intrinsics = Intrinsics::centred(options.width, options.height, focal_px);
    let mut jitter = |size: f64| size * (2.0 * random.random::<f64>() - 1.0);
    (0..options.views)
        .map(|i| {
            let (elevation_deg, distance) = RINGS[i % RINGS.len()];
            let elevation = (elevation_deg + jitter(4.0)).to_radians();
            let azimuth = TAU * (i as f64 + jitter(0.3)) / options.views as f64;
            let direction =
                DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let centre_world = CENTRE_WORLD + (distance + jitter(0.3)) * direction;
            let target_world = CENTRE_WORLD + DVec3::new(jitter(0.15), jitter(0.15), jitter(0.08));
            DemoCamera { intrinsics, cam_from_world: look_at(centre_world, target_world), centre_world }
        })
        .collect()
}

/// The pose of a camera that is held upright. It must not look straight up or down; the rings do not.
fn look_at(centre_world: DVec3, target_world: DVec3) -> DAffine3 {
    let forward = (target_world - centre_world).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let down = forward.cross(right);
    let cam_from_world = DMat3::from_cols(right, down, forward).transpose();
    DAffine3 { matrix3: cam_from_world, translation: -(cam_from_world * centre_world) }
}
