//! Normals of Gaussians, as tensor code on every device.

use burn::tensor::{Bool, Tensor};

use super::check_geometry;
use super::splats::Splats;
use crate::backend::custom_grad::{constant, plain};
use crate::camera::{Camera, CameraModel};
use crate::error::SplatError;
use crate::options::RenderOptions;

/// Returns the unit normal of each Gaussian, `[N, 3]`, world frame: its shortest axis, turned towards the camera. Of equally short axes it
/// is the first.
///
/// Differentiable in the rotations; which axis it is, and which way it is turned, are constants. As
/// [`Colour::Features`](crate::Colour::Features) the normals become a plane of normals, weighted as colours are; divide it by alpha for
/// their mean, which is shorter than one where normals differ.
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn normals(splats: &Splats, camera: &Camera) -> Result<Tensor<2>, SplatError> {
    check_geometry(splats, camera, &RenderOptions::standard())?;
    let count = splats.means.dims()[0];
    if count == 0 {
        return Ok(splats.means.clone());
    }
    // A zero quaternion, which is culled, counts as that of no rotation: its normal has no NaN, and no gradient.
    let tracked = splats.rotations.is_autodiff();
    let lifted = |mask: Tensor<2, Bool>| if tracked { Tensor::from_inner(mask) } else { mask };
    let values = plain(&splats.rotations);
    let largest = values.clone().abs().max_dim(1);
    let none = largest.clone().equal_elem(0.0);
    let unit =
        Tensor::<2>::from_floats([[1.0, 0.0, 0.0, 0.0]], &values.device()).cast(values.dtype()).expand([count, 4]);
    let given = splats.rotations.clone().mask_where(lifted(none.clone().expand([count, 4])), constant(&unit, tracked));
    // Scaled first, so that no length overflows.
    let q = given / constant(&largest.mask_fill(none, 1.0), tracked);
    let q = q.clone() / q.square().sum_dim(1).sqrt();
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| q.clone().narrow(1, i, 1));
    let twice = |a: &Tensor<2>, b: &Tensor<2>| (a.clone() * b.clone()).mul_scalar(2.0);
    let one_less = |a: Tensor<2>| a.neg().add_scalar(1.0);
    let axes = [
        vec![one_less(twice(&y, &y) + twice(&z, &z)), twice(&x, &y) + twice(&w, &z), twice(&x, &z) - twice(&w, &y)],
        vec![twice(&x, &y) - twice(&w, &z), one_less(twice(&x, &x) + twice(&z, &z)), twice(&y, &z) + twice(&w, &x)],
        vec![twice(&x, &z) + twice(&w, &y), twice(&y, &z) - twice(&w, &x), one_less(twice(&x, &x) + twice(&y, &y))],
    ];
    let shortest = plain(&splats.scales).argmin(1);
    let chosen = axes.into_iter().enumerate().map(|(i, axis)| {
        let is_shortest = shortest.clone().equal_elem(i as i64).expand([count, 3]);
        let axis = Tensor::cat(axis, 1);
        let none = axis.zeros_like();
        axis.mask_where(lifted(is_shortest.bool_not()), none)
    });
    let normal = chosen.reduce(|sum, axis| sum + axis).expect("three axes");

    let pose = plain(&camera.cam_from_world);
    let rotation = pose.clone().narrow(1, 0, 3).transpose();
    let translation = pose.narrow(1, 3, 1).transpose();
    let mean_cam = plain(&splats.means).matmul(rotation.clone()) + translation;
    let normal_cam = plain(&normal).matmul(rotation);
    let along = match camera.intrinsics.model {
        CameraModel::Orthographic => normal_cam.narrow(1, 2, 1),
        _ => (mean_cam * normal_cam).sum_dim(1),
    };
    let away = along.greater_elem(0.0).expand([count, 3]);
    let turned = normal.clone().neg();
    Ok(normal.mask_where(lifted(away), turned))
}
