//! The symmetry of panoramas: a quarter turn of the camera about its y axis moves the picture by a quarter of its width and changes no
//! gradient of the scene. The seam moves to where it was not, and the poles turn about themselves.

use burn::tensor::{DType, Device};

use crate::compare::relative_error;
use crate::evaluate::{Outputs, evaluate};
use crate::scene::{HardScene, OutputWeights};

/// Largest relative difference, by rounding in f64.
const TOLERANCE: f64 = 1e-9;

/// Returns in what a panorama differs from the one after a quarter turn, a sentence each. `plain` are its outputs in f64.
pub fn asymmetries(scene: &HardScene, weights: &OutputWeights, plain: &Outputs) -> Vec<String> {
    let width = scene.intrinsics.width;
    let shifted = |values: &[f64], columns: usize| -> Vec<f64> {
        let mut values = values.to_vec();
        values.chunks_mut(width * columns).for_each(|row| row.rotate_right(width / 4 * columns));
        values
    };
    let negated = |row: &[f64]| row.iter().map(|value| -value).collect::<Vec<f64>>();
    let pose = [&scene.pose[8..], &scene.pose[4..8], &negated(&scene.pose[..4])].concat();
    let weights = OutputWeights {
        image: shifted(&weights.image, scene.channels()),
        alpha: shifted(&weights.alpha, 1),
        depth: shifted(&weights.depth, 1),
    };
    let turned = evaluate(&HardScene { pose, ..scene.clone() }, &weights, &Device::flex(), DType::F64);
    let pictures = turned.pictures.iter().zip(&plain.pictures).map(|(turned, plain)| {
        let moved = shifted(&plain.values, plain.columns);
        (plain.name, turned.values.clone(), moved)
    });
    // The probe counts pixels of the faces, which turn at the poles.
    let gradients = turned.gradients.iter().zip(&plain.gradients).filter(|(_, plain)| plain.name != "mean2d");
    let gradients = gradients.map(|(turned, plain)| {
        let (found, expected) = (&turned.values, plain.values.clone());
        let found = match plain.name {
            "pose" => [&negated(&found[8..]), &found[4..8], &found[..4]].concat(),
            _ => found.clone(),
        };
        (plain.name, found, expected)
    });
    let errors = pictures.chain(gradients).map(|(name, found, expected)| (name, relative_error(&found, &expected)));
    let off = errors.filter(|(_, error)| !(*error <= TOLERANCE));
    off.map(|(name, error)| format!("{name}: a quarter turn changes it by {error:.1e}")).collect()
}
