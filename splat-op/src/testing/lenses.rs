//! Lenses for tests.

use crate::camera::CameraModel;

/// Lens of the capture `fox_distorted`, whose polynomial has a turning point not far outside its picture.
pub const FOX: (CameraModel, [f64; 8]) =
    (CameraModel::OpenCv, [0.056_265, -0.079_533, -0.000_75, -0.000_204, 0.0, 0.0, 0.0, 0.0]);

/// A camera with parallel rays.
pub const ORTHOGRAPHIC: (CameraModel, [f64; 8]) = (CameraModel::Orthographic, [0.0; 8]);

/// One or two moderate lenses of each model, with all coefficients non-zero.
pub fn lenses() -> Vec<(CameraModel, [f64; 8])> {
    vec![
        FOX,
        (CameraModel::OpenCv, [-0.12, 0.03, 0.004, -0.006, 0.0, 0.0, 0.0, 0.0]),
        (CameraModel::FullOpenCv, [0.2, 0.05, 0.003, -0.004, 0.02, 0.35, 0.1, 0.02]),
        (CameraModel::Fisheye, [0.0; 8]),
        (CameraModel::Fisheye, [0.05, -0.02, 0.01, -0.003, 0.0, 0.0, 0.0, 0.0]),
        (CameraModel::ThinPrismFisheye, [0.03, -0.02, 0.004, -0.005, 0.01, -0.002, 0.003, -0.002]),
    ]
}
