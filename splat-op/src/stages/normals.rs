//! Normals of Gaussians, as tensor code on every device.

use burn::tensor::{Bool, Int, Tensor};

use super::checked::Checked;
use crate::backend::custom_grad::{constant, plain};
use crate::{Camera, CameraModel, RenderOptions, Result, Splats};

/// Returns the unit normal of each Gaussian, `[N, 3]`, world frame: its shortest axis, turned towards the camera. Of equally short axes the first.
///
/// Differentiable in the rotations; which axis it is, and which way it is turned, are constants. As
/// [`Colour::Features`](crate::Colour::Features) the normals become a plane of normals, weighted as colours are; divide it by alpha for
/// their mean, which is shorter than one where normals differ.
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn normals(splats: &Splats, camera: &Camera) -> Result<Tensor<2>> {
    let options = RenderOptions::standard();
    Checked::gaussians(splats, &options)?.camera(camera)?;
    Ok(facing(splats, camera))
}

/// [`normals`] of inputs that have been checked.
pub(super) fn facing(splats: &Splats, camera: &Camera) -> Tensor<2> {
    let count = splats.means.dims()[0];
    if count == 0 {
        return splats.means.clone();
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
    let (w, v) = (q.clone().narrow(1, 0, 1), q.narrow(1, 1, 3));
    let columns = Tensor::<1, Int>::arange(0..3, &values.device()).unsqueeze::<2>().expand([count, 3]);
    let shortest = plain(&splats.scales).argmin(1).expand([count, 3]);
    let axis = constant(&columns.equal(shortest).float().cast(values.dtype()), tracked);
    // The axis, rotated by the quaternion.
    let twice = v.clone().cross(axis.clone(), 1).mul_scalar(2.0);
    let normal = axis + w * twice.clone() + v.cross(twice, 1);

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
    normal.mask_where(lifted(away), turned)
}
