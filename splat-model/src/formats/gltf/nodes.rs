//! Transforms of nodes, and their effect on Gaussians.

use std::f64::consts::TAU;

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};
use splat_op::sh::harmonics;

use super::DEGREE_MAX;
use super::document::{Document, Node};
use crate::gaussians::GaussianRows;

/// Largest relative difference of a transform's columns from orthogonal ones of equal length: what is left by a matrix in f32.
const SHEAR_MAX: f64 = 1e-4;

/// Returns the meshes of the document's scene in its order, each with `world_from_mesh`.
///
/// # Errors
/// If a node or a mesh does not exist, or a node has two parents.
pub fn meshes(document: &Document) -> Result<Vec<(usize, DAffine3)>, String> {
    let scene = document.scene.unwrap_or(0);
    // A document without scenes is a library of meshes.
    let roots = match document.scenes.get(scene) {
        Some(roots) => roots.nodes.clone(),
        None if document.scenes.is_empty() && document.scene.is_none() => {
            return Ok((0..document.meshes.len()).map(|mesh| (mesh, DAffine3::IDENTITY)).collect());
        }
        None => return Err(format!("no scene {scene} in {} scenes", document.scenes.len())),
    };
    let mut visited = vec![false; document.nodes.len()];
    let mut left: Vec<(usize, DAffine3)> = roots.iter().rev().map(|&node| (node, DAffine3::IDENTITY)).collect();
    let mut found = Vec::new();
    while let Some((index, world_from_parent)) = left.pop() {
        let node = document.nodes.get(index).ok_or_else(|| format!("no node {index} in {} nodes", visited.len()))?;
        // Without this, a node that is below itself would have no end.
        if std::mem::replace(&mut visited[index], true) {
            return Err(format!("node {index} has two parents, expected one at most"));
        }
        let world_from_node = world_from_parent * parent_from(node);
        found.extend(node.mesh.map(|mesh| (mesh, world_from_node)));
        left.extend(node.children.iter().rev().map(|&child| (child, world_from_node)));
    }
    match found.iter().find(|(mesh, _)| *mesh >= document.meshes.len()) {
        Some((mesh, _)) => Err(format!("no mesh {mesh} in {} meshes", document.meshes.len())),
        None => Ok(found),
    }
}

fn parent_from(node: &Node) -> DAffine3 {
    match &node.matrix {
        Some(matrix) => DAffine3::from_mat4(DMat4::from_cols_array(matrix)),
        None => DAffine3::from_scale_rotation_translation(
            DVec3::from_array(node.scale.unwrap_or([1.0; 3])),
            DQuat::from_array(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0])).normalize(),
            DVec3::from_array(node.translation.unwrap_or_default()),
        ),
    }
}

/// Moves Gaussians by a transform.
///
/// # Errors
/// If the transform is not finite, or is more than a rotation, a translation and one positive scale: other transforms do not turn
/// Gaussians with harmonics into such Gaussians.
pub fn transform(rows: &mut GaussianRows, world_from_mesh: &DAffine3) -> Result<(), String> {
    if *world_from_mesh == DAffine3::IDENTITY {
        return Ok(());
    }
    let matrix = world_from_mesh.matrix3;
    let scale = matrix.determinant().cbrt();
    let rotation = matrix * scale.recip();
    let excess = rotation.transpose() * rotation - DMat3::IDENTITY;
    let similar = excess.to_cols_array().iter().all(|value| value.abs() < SHEAR_MAX);
    if !(scale > 0.0 && scale.is_finite() && similar && world_from_mesh.translation.is_finite()) {
        return Err("a node's transform is sheared, mirrored, not finite, or of different scales by axis, expected a rotation, a \
                    translation and one scale: apply the transform to the splats first"
            .into());
    }
    let turn = DQuat::from_mat3(&rotation).normalize();
    for mean in &mut rows.means {
        *mean = world_from_mesh.transform_point3(DVec3::from_array(mean.map(f64::from))).as_vec3().to_array();
    }
    for [w, x, y, z] in &mut rows.rotations {
        let turned = turn * DQuat::from_array([*x, *y, *z, *w].map(f64::from));
        [*x, *y, *z, *w] = turned.to_array().map(|value| value as f32);
    }
    for log in rows.log_scales.as_flattened_mut() {
        *log += scale.ln() as f32;
    }
    rotate_harmonics(rows, &rotation);
    Ok(())
}

/// Rotates the harmonics: the colour in direction `R d` becomes what it was in direction `d`. With an orthonormal basis, the new
/// coefficient `m` is `Σₙ cₙ ∫ Yₘ(R d) Yₙ(d) dd`, within a degree. The integrand is a polynomial of degree 6 at most, for which four Gauss-Legendre
/// heights of eight directions are exact.
fn rotate_harmonics(rows: &mut GaussianRows, rotation: &DMat3) {
    const COEFFICIENTS: usize = (DEGREE_MAX + 1) * (DEGREE_MAX + 1);
    /// Nodes and weights on −1..1.
    const HEIGHTS: [(f64, f64); 2] =
        [(0.339_981_043_584_856_26, 0.652_145_154_862_546_1), (0.861_136_311_594_052_6, 0.347_854_845_137_453_85)];
    let per_row = rows.rest_per_row();
    if per_row == 0 {
        return;
    }
    let mut new_from_old = [[0.0; COEFFICIENTS]; COEFFICIENTS];
    for (height, weight) in HEIGHTS.into_iter().flat_map(|(height, weight)| [(height, weight), (-height, weight)]) {
        for i in 0..8 {
            let (sin, cos) = (TAU / 8.0 * f64::from(i)).sin_cos();
            let radius = (1.0 - height * height).sqrt();
            let d = DVec3::new(radius * cos, radius * sin, height);
            let (old, new) = (harmonics(d.to_array(), DEGREE_MAX), harmonics((*rotation * d).to_array(), DEGREE_MAX));
            for m in 1..COEFFICIENTS {
                for n in (m.isqrt() * m.isqrt())..((m.isqrt() + 1) * (m.isqrt() + 1)) {
                    new_from_old[m][n] += weight * TAU / 8.0 * new[m] * old[n];
                }
            }
        }
    }
    for row in rows.sh_rest.chunks_exact_mut(per_row) {
        let old: Vec<f64> = row.iter().map(|&value| f64::from(value)).collect();
        for (at, value) in row.iter_mut().enumerate() {
            let (m, channel) = (1 + at / 3, at % 3);
            let of_degree = (m.isqrt() * m.isqrt())..((m.isqrt() + 1) * (m.isqrt() + 1));
            *value = of_degree.map(|n| new_from_old[m][n] * old[3 * (n - 1) + channel]).sum::<f64>() as f32;
        }
    }
}
