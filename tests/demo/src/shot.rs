//! How one photograph is taken: the camera's pose over time, and what occludes the scene.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec2, DVec3};
use rand::{Rng, RngExt};

use super::DemoOptions;
use super::camera::{DemoCamera, cameras};
use super::geometry::Ray;
use super::grade::Grade;
use super::light::display;
use super::options::Stream;

/// The interval of motion-blurred photographs among those that are not held out.
const BLURRED_EVERY: usize = 5;

/// A steady motion of the camera over an exposure or a readout, in the camera's own frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Motion {
    /// Scene units.
    pub linear_cam: DVec3,
    /// Rotation vector, radians.
    pub angular_cam: DVec3,
}

impl Motion {
    /// A motion in a random direction that moves objects at `distance` by `share` of the picture's width.
    fn random(random: &mut impl Rng, camera: &DemoCamera, share: f64) -> Self {
        let angle = TAU * random.random::<f64>();
        let direction_cam = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let slope = share * camera.intrinsics.width as f64 / camera.intrinsics.fx;
        // Moving to a side and turning to it both shift the picture to the other side.
        Self {
            linear_cam: 0.5 * slope * camera.subject_distance * direction_cam,
            angular_cam: 0.5 * slope * DVec3::Z.cross(direction_cam),
        }
    }

    fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// A bright disc before the lens, which is not part of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Disc {
    pub middle_px: DVec2,
    pub radius_px: f64,
    /// Linear light.
    pub light: DVec3,
}

/// One photograph.
#[derive(Clone, Debug)]
pub(super) struct Shot {
    /// The camera at the middle of the exposure and of the readout.
    pub camera: DemoCamera,
    /// Gain on linear light, per channel.
    pub gain: DVec3,
    /// Local processing, if any.
    pub grade: Option<Grade>,
    /// Motion during the exposure.
    pub motion: Motion,
    /// Motion from the first row's exposure to the last row's.
    pub readout: Motion,
    pub discs: Vec<Disc>,
    /// Whether ground and sky are transparent.
    pub transparent: bool,
}

impl Shot {
    /// A sharp photograph of everything.
    pub fn plain(camera: DemoCamera) -> Self {
        let (gain, motion, readout) = (DVec3::ONE, Motion::default(), Motion::default());
        Self { camera, gain, grade: None, motion, readout, discs: Vec::new(), transparent: false }
    }

    /// Whether a pixel needs rays from many moments of the exposure.
    pub fn is_blurred(&self) -> bool {
        !self.motion.is_none()
    }

    /// The camera at a time of the exposure of the row at a position, px: −½ to ½, from its beginning to its end.
    pub fn camera_at(&self, row_px: f64, time: f64) -> DemoCamera {
        let read_out = row_px / self.camera.intrinsics.height as f64 - 0.5;
        let along = |of: fn(&Motion) -> DVec3| time * of(&self.motion) + read_out * of(&self.readout);
        let (linear_cam, angular_cam) = (along(|motion| motion.linear_cam), along(|motion| motion.angular_cam));
        let turned = DMat3::from_quat(DQuat::from_scaled_axis(angular_cam));
        self.camera.moved(self.camera.centre_world + self.camera.world_from_cam() * linear_cam, turned)
    }

    /// A ray that ends at a position of the picture, px, at a time of the exposure, −½ to ½; world frame.
    pub fn ray(&self, at_px: DVec2, time: f64) -> Ray {
        match self.motion.is_none() && self.readout.is_none() {
            true => self.camera.ray_through(at_px),
            false => self.camera_at(at_px.y, time).ray_through(at_px),
        }
    }

    /// The position of a point's sharp image, px, and the camera at that time, if it lies within the picture.
    pub fn project(&self, point_world: DVec3) -> Option<(DVec2, DemoCamera)> {
        let mut camera = self.camera;
        let mut at_px = camera.project(point_world)?;
        if !self.readout.is_none() {
            // The row that shows the point decides the time, and the time decides the row: a twentieth of the width from the
            // first row to the last, so that each iteration leaves less than a tenth of the error.
            for _ in 0..16 {
                camera = self.camera_at(at_px.y, 0.0);
                at_px = camera.project(point_world)?;
            }
        }
        camera.shows(at_px).then_some((at_px, camera))
    }

    /// The stored values, 0 to 1, of linear light at a position of the picture, px.
    pub fn display(&self, light: DVec3, at_px: DVec2) -> DVec3 {
        let exposed = self.gain * light;
        self.grade.map_or_else(|| display(exposed), |grade| grade.display(exposed, &self.camera, at_px))
    }

    /// The disc that occludes the scene at a position of the picture.
    pub fn disc_at(&self, at_px: DVec2) -> Option<&Disc> {
        self.discs.iter().find(|disc| disc.middle_px.distance(at_px) <= disc.radius_px)
    }
}

/// The photographs of a capture.
pub(super) fn shots(options: &DemoOptions) -> Vec<Shot> {
    let [mut discs, mut motions, mut readouts, mut grades] =
        [Stream::Discs, Stream::Motion, Stream::Rolling, Stream::Grades].map(|stream| options.random(stream));
    let taken = cameras(options).into_iter().zip(gains(options)).enumerate();
    let shots = taken.map(|(view, (camera, gain))| {
        let mut shot = Shot { gain, transparent: options.alpha, ..Shot::plain(camera) };
        if DemoOptions::held_out(view) {
            return shot;
        }
        shot.grade = options.graded.then(|| Grade::random(&mut grades));
        if options.rolling {
            shot.readout = Motion::random(&mut readouts, &camera, DemoOptions::ROLLING_SHARE);
        }
        if options.masks {
            shot.discs = (0..DemoOptions::MASKED_PLACES).map(|_| disc(&mut discs, options)).collect();
        }
        // The second and fourth of each five photographs, so that a capture of three views has one.
        let number = view - view / DemoOptions::HELD_OUT_EVERY - 1;
        if options.motion && matches!(number % BLURRED_EVERY, 1 | 3) {
            shot.motion = Motion::random(&mut motions, &camera, DemoOptions::MOTION_SHARE);
        }
        shot
    });
    shots.collect()
}

/// The gain of each photograph, per channel: one, unless exposures differ.
pub fn gains(options: &DemoOptions) -> Vec<DVec3> {
    let mut random = options.random(Stream::Exposures);
    let mut gain = || (DemoOptions::EXPOSURE_STOPS * (2.0 * random.random::<f64>() - 1.0)).exp2();
    let mut of_view = || if options.exposure { DVec3::new(gain(), gain(), gain()) } else { DVec3::ONE };
    (0..options.views).map(|_| of_view()).collect()
}

fn disc(random: &mut impl Rng, options: &DemoOptions) -> Disc {
    let size_px = DVec2::new(options.width as f64, options.height as f64);
    let middle_px = size_px * DVec2::new(random.random(), random.random());
    let [least, largest] = DemoOptions::MASKED_SIZE;
    let radius_px = 0.5 * size_px.x * (least + (largest - least) * random.random::<f64>());
    // One channel is bright and one dark: no colour of the scene is as saturated.
    let mut light = [3.5, 3.5 * random.random::<f64>(), 0.02];
    light.rotate_left(random.random_range(0..3));
    Disc { middle_px, radius_px, light: DVec3::from(light) }
}
