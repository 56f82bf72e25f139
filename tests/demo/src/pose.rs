//! Perturbed poses.

use glam::{DAffine3, DMat3, DVec3};
use rand::{Rng, RngExt};

use super::DemoOptions;
use super::camera::DemoCamera;
use super::options::Stream;
use super::shot::Shot;
use splat_model::optim::scene_extent;

/// The poses written to the model: those of the shots, perturbed unless held out where `poses` asks for it.
pub(super) fn written(shots: &[Shot], options: &DemoOptions) -> Vec<DAffine3> {
    let mut random = options.random(Stream::Poses);
    let centres: Vec<DVec3> = shots.iter().map(|shot| shot.camera.centre_world).collect();
    let distance = DemoOptions::POSE_SHARE * scene_extent(&centres);
    let mut pose = |(view, shot): (usize, &Shot)| {
        let exact = !options.poses || DemoOptions::held_out(view);
        let camera = if exact { shot.camera } else { disturbed(&mut random, shot.camera, distance) };
        camera.cam_from_world
    };
    shots.iter().enumerate().map(&mut pose).collect()
}

fn disturbed(random: &mut impl Rng, camera: DemoCamera, distance: f64) -> DemoCamera {
    let turn = DMat3::from_axis_angle(unit(random), DemoOptions::POSE_ANGLE_DEG.to_radians());
    camera.moved(camera.centre_world + distance * unit(random), turn)
}

/// A uniformly distributed direction.
fn unit(random: &mut impl Rng) -> DVec3 {
    // Heights on a sphere are uniform (Archimedes).
    let z = 2.0 * random.random::<f64>() - 1.0;
    let (sin, cos) = (std::f64::consts::TAU * random.random::<f64>()).sin_cos();
    let across = (1.0 - z * z).sqrt();
    DVec3::new(across * cos, across * sin, z)
}
