//! The demo's cameras: three rings around the still life.

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use rand::RngExt;
use splat_op::{CameraModel, Intrinsics, Projector};

use super::DemoOptions;
use super::geometry::Ray;
use super::options::Stream;
use super::scene::DemoScene;

/// Horizontal field of view.
const FOV_X_DEG: f64 = 50.0;

/// The point that the cameras look at, world frame (z up, the platform's top at z = 0).
pub(super) const CENTRE_WORLD: DVec3 = DVec3::new(0.0, 0.0, 0.32);

/// Elevation in degrees and distance in scene units of each ring.
const RINGS: [(f64, f64); 3] = [(13.0, 4.9), (29.0, 4.5), (50.0, 4.3)];

/// Reduction of the elevations, degrees, where there is a distant landscape.
const FAR_ELEVATION: f64 = 0.4;

/// Shift of the target upwards there, scene units, which puts the horizon in the picture's middle.
const FAR_LIFT: f64 = 1.0;

/// The lens terms `k1 r², k2 r⁴, p1 r, p2 r` at the picture's corner, whose slope from the axis is `r`: the distortion has the
/// same shape in pictures of every aspect ratio. They move the corners by 3% to [`DemoOptions::LENS_SHARE`] of the width, at 4:3.
const LENS_AT_CORNER: [f64; 4] = [-0.0587, 0.0107, 0.0016, -0.0021];

/// One photograph's camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct DemoCamera {
    pub intrinsics: Intrinsics,
    projector: Projector,
    /// The pose: rigid, OpenCV axes.
    pub cam_from_world: DAffine3,
    pub centre_world: DVec3,
    /// Distance to the target, scene units.
    pub subject_distance: f64,
}

impl DemoCamera {
    /// An upright camera. It must not look straight up or down.
    pub fn looking(intrinsics: Intrinsics, centre_world: DVec3, target_world: DVec3) -> Self {
        let forward = (target_world - centre_world).normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let down = forward.cross(right);
        let cam_from_world = DMat3::from_cols(right, down, forward).transpose();
        Self {
            intrinsics,
            projector: intrinsics.projector(),
            cam_from_world: DAffine3 { matrix3: cam_from_world, translation: -(cam_from_world * centre_world) },
            centre_world,
            subject_distance: centre_world.distance(target_world),
        }
    }

    /// The camera at another place, with its axes turned by the rotation `cam_from_turned` of its own frame.
    pub fn moved(self, centre_world: DVec3, cam_from_turned: DMat3) -> Self {
        let turned_from_world = cam_from_turned.transpose() * self.cam_from_world.matrix3;
        let cam_from_world = DAffine3 { matrix3: turned_from_world, translation: -(turned_from_world * centre_world) };
        Self { cam_from_world, centre_world, ..self }
    }

    /// The axes of the camera's frame in the world.
    pub fn world_from_cam(&self) -> DMat3 {
        self.cam_from_world.matrix3.transpose()
    }

    /// The direction in the camera's frame that projects to a position in the picture, px; not of unit length.
    pub fn direction_cam(&self, at_px: DVec2) -> DVec3 {
        self.projector.cam_from_px(at_px)
    }

    /// The ray through a position in the picture, px; world frame.
    pub fn ray_through(&self, at_px: DVec2) -> Ray {
        let direction = (self.world_from_cam() * self.direction_cam(at_px)).normalize();
        Ray { origin: self.centre_world, direction }
    }

    /// The projection of a point, px, if it lies in front of the camera and within the lens's field. It may lie outside the picture.
    pub fn project(&self, point_world: DVec3) -> Option<DVec2> {
        let Intrinsics { model, fx, fy, cx, cy, .. } = self.intrinsics;
        let point_cam = self.cam_from_world.transform_point3(point_world);
        if model != CameraModel::Pinhole {
            return self.projector.px_from_cam(point_cam);
        }
        let at_px = DVec2::new(fx * point_cam.x / point_cam.z + cx, fy * point_cam.y / point_cam.z + cy);
        (point_cam.z > 0.0).then_some(at_px)
    }

    /// Whether a position lies within the picture.
    pub fn shows(&self, at_px: DVec2) -> bool {
        let size_px = DVec2::new(self.intrinsics.width as f64, self.intrinsics.height as f64);
        at_px.cmpge(DVec2::ZERO).all() && at_px.cmplt(size_px).all()
    }
}

/// The cameras of a capture. Neighbours in the list stand on different rings, so that any regular choice of views for
/// testing covers all heights.
pub(super) fn cameras(options: &DemoOptions) -> Vec<DemoCamera> {
    let mut random = options.random(Stream::Cameras);
    let intrinsics = intrinsics(options);
    let scene = options.zoom.then(|| DemoScene::still_life(options));
    let (lower, lift) = if options.far { (FAR_ELEVATION, FAR_LIFT) } else { (1.0, 0.0) };
    let mut jitter = |size: f64| size * (2.0 * random.random::<f64>() - 1.0);
    (0..options.views)
        .map(|i| {
            let (elevation_deg, distance) = RINGS[i % RINGS.len()];
            let elevation = lower * (elevation_deg + jitter(4.0)).to_radians();
            let azimuth = TAU * (i as f64 + jitter(0.3)) / options.views as f64;
            let direction =
                DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let centre_world = CENTRE_WORLD + (distance + jitter(0.3)) * direction;
            let target_world = CENTRE_WORLD + DVec3::new(jitter(0.15), jitter(0.15), jitter(0.08) + lift);
            let (centre_world, target_world) = match &scene {
                Some(scene) => zoomed(scene, i, centre_world, target_world),
                None => (centre_world, target_world),
            };
            DemoCamera::looking(intrinsics, centre_world, target_world)
        })
        .collect()
}

fn intrinsics(options: &DemoOptions) -> Intrinsics {
    let [width, height] = [options.width, options.height].map(|side| side as f64);
    if options.fisheye {
        let focal_px = 0.5 * width.max(height) / (0.5 * DemoOptions::FISHEYE_FOV_DEG).to_radians();
        let pinhole = Intrinsics::centred(options.width, options.height, focal_px);
        return pinhole.with_lens(CameraModel::Fisheye, [0.0; 8]);
    }
    let focal_px = 0.5 * width / (0.5 * FOV_X_DEG).to_radians().tan();
    let pinhole = Intrinsics::centred(options.width, options.height, focal_px);
    if !options.lens {
        return pinhole;
    }
    let corner = 0.5 * width.hypot(height) / focal_px;
    let [k1, k2, p1, p2] = LENS_AT_CORNER;
    let mut distortion = [0.0; 8];
    distortion[..4].copy_from_slice(&[k1 / corner.powi(2), k2 / corner.powi(4), p1 / corner, p2 / corner]);
    pinhole.with_lens(CameraModel::OpenCv, distortion)
}

/// Centre and target of a camera at its distance, which is usual, near or far in turn. The target is what an ordinary
/// photograph shows in its middle, so that nothing lies between.
fn zoomed(scene: &DemoScene, i: usize, centre_world: DVec3, target_world: DVec3) -> (DVec3, DVec3) {
    // Chosen by the index, so that three successive held-out views, whose indices differ by 8 and 16, have all three distances; every 24
    // views the rings change places.
    let times = match (i + i / (3 * DemoOptions::HELD_OUT_EVERY)) % 3 {
        0 => return (centre_world, target_world),
        1 => DemoOptions::ZOOM_NEAR,
        _ => DemoOptions::ZOOM_FAR,
    };
    let ray = Ray { origin: centre_world, direction: (target_world - centre_world).normalize() };
    let subject_world = scene.hit(&ray).map_or(target_world, |point| point.position_world);
    (subject_world + times * (centre_world - subject_world), subject_world)
}
