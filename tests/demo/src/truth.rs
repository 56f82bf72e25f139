//! `truth.json`: how each photograph was taken, which the model and the photographs do not say.

use glam::{DQuat, DVec3};

use super::View;
use super::shot::{Motion, Shot};

/// The text of `truth.json`, see [`super::write`].
pub(super) fn json(views: &[View], shots: &[Shot]) -> String {
    let photograph = |(view, shot): (&View, &Shot)| {
        let DQuat { x, y, z, w } = DQuat::from_mat3(&shot.camera.cam_from_world.matrix3);
        let translation = list(shot.camera.cam_from_world.translation);
        let (exposure, readout) = (motion(&shot.motion), motion(&shot.readout));
        // Names are four digits and an extension: nothing to escape.
        format!(
            "\n    {{\"name\": \"{}\", \"rotation_wxyz\": [{w:?}, {x:?}, {y:?}, {z:?}], \
             \"translation\": {translation}, \"exposure\": {exposure}, \"readout\": {readout}}}",
            view.name
        )
    };
    let photographs: Vec<String> = views.iter().zip(shots).map(photograph).collect();
    format!("{{\n  \"photographs\": [{}\n  ]\n}}\n", photographs.join(","))
}

fn motion(motion: &Motion) -> String {
    format!("{{\"linear\": {}, \"angular\": {}}}", list(motion.linear_cam), list(motion.angular_cam))
}

/// A number in JSON. Rust's shortest round-trip decimals are valid JSON if they are finite.
fn list(v: DVec3) -> String {
    format!("{:?}", v.to_array())
}
