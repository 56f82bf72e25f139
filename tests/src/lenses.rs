//! Cameras with lens models other than the pinhole.

use splat_op::{CameraModel, Intrinsics};

/// Returns a camera with each lens model and moderate coefficients. The distortion of the first turns back not far outside the
/// pictures of these tests, and one lens is equidistant.
pub fn lenses(camera: Intrinsics) -> [Intrinsics; 5] {
    let lens = |model, distortion| camera.with_lens(model, distortion);
    [
        lens(CameraModel::OpenCv, [-0.25, -0.1, 0.004, -0.006, 0.0, 0.0, 0.0, 0.0]),
        lens(CameraModel::FullOpenCv, [0.2, 0.05, 0.003, -0.004, 0.02, 0.35, 0.1, 0.02]),
        lens(CameraModel::Fisheye, [0.0; 8]),
        lens(CameraModel::Fisheye, [0.05, -0.02, 0.01, -0.003, 0.0, 0.0, 0.0, 0.0]),
        lens(CameraModel::ThinPrismFisheye, [0.03, -0.02, 0.004, -0.005, 0.01, -0.002, 0.003, -0.002]),
    ]
}
