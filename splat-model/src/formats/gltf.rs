//! glTF 2.0 with the extension `KHR_gaussian_splatting`, as ratified by Khronos
//! (<https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_gaussian_splatting>; glTF 2.0, §3.6 to §3.7 for buffers and
//! meshes, §4.4 for the binary container).
//!
//! A scene is a mesh primitive of points whose attributes have one element per Gaussian:
//!
//! | attribute | written as | holds |
//! |---|---|---|
//! | `POSITION` | 3 floats | the centre |
//! | `COLOR_0` | 4 normalised bytes | colour and opacity for programs that draw points |
//! | `KHR_gaussian_splatting:ROTATION` | 4 floats | a unit quaternion, `x y z w` |
//! | `KHR_gaussian_splatting:SCALE` | 3 floats | standard deviations, not their logarithms |
//! | `KHR_gaussian_splatting:OPACITY` | 1 float | the opacity, 0 to 1 |
//! | `KHR_gaussian_splatting:SH_DEGREE_l_COEF_n` | 3 floats each | the harmonic of degree `l`, order `n − l`, of the three channels; `l` to 3 |
//!
//! Attributes are written as floats, so that conversion loses nothing but the rounding of `exp` and the logistic function. The format is
//! written for other programs, and not read.
//!
//! **Frame.** glTF is left-up-front: half a turn about `z` from the frame of scenes here. `asset.extras` stores the origin, in the frame of
//! scenes here, and the mark of antialiasing; the format itself has no place for them.
//!
//! The binary container is written; its JSON twin would be a third larger. [`mesh`] writes triangles into it.
//!
//! **Crates.** `gltf` 1.4 refuses attributes whose names have a colon, as those of the extension do.

mod container;
pub(super) mod mesh;
#[cfg(test)]
mod tests;

use std::path::Path;

use serde_json::json;

use self::container::{Attribute, UNSIGNED_BYTE, floats, positions};
use super::frame::HalfTurn;
use super::{SceneFile, extras, opacity};
use crate::FileError;
use crate::gaussians::{DC, GaussianRows, sigmoid};

pub(super) const DEGREE_MAX: usize = 3;

const EXTENSION: &str = "KHR_gaussian_splatting";

/// Name of the attribute of harmonic `k` in the order of the coefficients, `k = l² + n`.
fn harmonic(k: usize) -> String {
    let l = k.isqrt();
    format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{}", k - l * l)
}

/// Range of the logarithms of standard deviations that are positive, finite floats.
const LOG_SCALES: (f32, f32) = (-87.0, 88.0);

/// Writes rows that fit the format ([`super::fit`]). `scene` gives the origin and the mark of antialiasing.
pub(super) fn write(path: &Path, rows: &GaussianRows, scene: &SceneFile) -> Result<(), FileError> {
    let mut extras = extras::of(scene.world());
    if scene.trained.antialias {
        extras.insert("antialiased".into(), json!(true));
    }
    let splatting = json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective", "sortingMethod": "cameraDistance"
    });
    let primitive = json!({ "mode": 0, "extensions": { EXTENSION: splatting } });
    container::write(path, &attributes(rows), primitive, extras, json!({ "extensionsUsed": [EXTENSION] }))
}

fn attributes(rows: &GaussianRows) -> Vec<Attribute> {
    let turn = HalfTurn::Z;
    let axes = turn.axes();
    let colour = |i: usize| {
        // The cast clamps.
        let [r, g, b] = rows.sh_dc[i].map(|dc| (255.0 * (0.5 + DC * f64::from(dc))).round() as u8);
        [r, g, b, opacity::level(rows.logit_opacities[i])]
    };
    let colours = (0..rows.len()).flat_map(colour).collect();
    let rotations = rows.rotations.iter().map(|rotation| {
        let [w, x, y, z] = rotation.map(f64::from);
        let length = [w, x, y, z].iter().map(|value| value * value).sum::<f64>().sqrt();
        let unit = [x, y, z, w].map(|value| (value / length) as f32);
        [axes[0] * unit[0], axes[1] * unit[1], axes[2] * unit[2], unit[3]]
    });
    let scales = rows
        .log_scales
        .iter()
        .map(|logs| logs.map(|log| f64::from(log.clamp(LOG_SCALES.0, LOG_SCALES.1)).exp() as f32));
    let opacities = rows.logit_opacities.iter().map(|&logit| [sigmoid(logit) as f32]);
    let mut attributes = vec![
        positions(&rows.means),
        Attribute::new("COLOR_0", UNSIGNED_BYTE, 4, rows.len(), colours),
        floats(format!("{EXTENSION}:ROTATION"), rotations),
        floats(format!("{EXTENSION}:SCALE"), scales),
        floats(format!("{EXTENSION}:OPACITY"), opacities),
        floats(harmonic(0), rows.sh_dc.iter().copied()),
    ];
    let per_row = rows.rest_per_row();
    attributes.extend((1..1 + per_row / 3).map(|k| {
        let of = |row: &[f32]| [0, 1, 2].map(|channel| turn.sign(k) * row[3 * (k - 1) + channel]);
        floats(harmonic(k), rows.sh_rest.chunks_exact(per_row).map(of))
    }));
    attributes
}
