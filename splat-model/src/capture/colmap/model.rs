//! Maps COLMAP's camera models to this crate's.

use splat_op::CameraModel;

/// A supported COLMAP model and its parameter layout: one or two focal lengths, the principal point, and
/// the first coefficients of our model; the others are zero. A panorama has width and height alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ColmapCameraModel {
    pub ours: CameraModel,
    /// 1 or 2, and 0 of a panorama.
    pub focals: usize,
    pub coefficients: usize,
}

/// COLMAP's model names by id, with our model where there is one (`src/colmap/sensor/models.h`).
const MODELS: [(&str, Option<ColmapCameraModel>); 18] = [
    ("SIMPLE_PINHOLE", model(CameraModel::Pinhole, 1, 0)),
    ("PINHOLE", model(CameraModel::Pinhole, 2, 0)),
    ("SIMPLE_RADIAL", model(CameraModel::OpenCv, 1, 1)),
    ("RADIAL", model(CameraModel::OpenCv, 1, 2)),
    ("OPENCV", model(CameraModel::OpenCv, 2, 4)),
    ("OPENCV_FISHEYE", model(CameraModel::Fisheye, 2, 4)),
    ("FULL_OPENCV", model(CameraModel::FullOpenCv, 2, 8)),
    ("FOV", None),
    ("SIMPLE_RADIAL_FISHEYE", model(CameraModel::Fisheye, 1, 1)),
    ("RADIAL_FISHEYE", model(CameraModel::Fisheye, 1, 2)),
    ("THIN_PRISM_FISHEYE", model(CameraModel::ThinPrismFisheye, 2, 8)),
    ("RAD_TAN_THIN_PRISM_FISHEYE", None),
    ("SIMPLE_DIVISION", None),
    ("DIVISION", None),
    ("SIMPLE_FISHEYE", model(CameraModel::Fisheye, 1, 0)),
    ("FISHEYE", model(CameraModel::Fisheye, 2, 0)),
    ("EUCM", None),
    ("EQUIRECTANGULAR", model(CameraModel::Pinhole, 0, 0)),
];

const fn model(ours: CameraModel, focals: usize, coefficients: usize) -> Option<ColmapCameraModel> {
    Some(ColmapCameraModel { ours, focals, coefficients })
}

impl ColmapCameraModel {
    /// The largest number of parameters of any model.
    pub const MOST_PARAMETERS: usize = 12;

    /// The number of parameters that follow the picture's size.
    pub const fn parameters(self) -> usize {
        self.focals + 2 + self.coefficients
    }

    /// COLMAP's name for a model id, or the id itself where there is none.
    pub fn name(number: i32) -> String {
        let known = usize::try_from(number).ok().and_then(|number| MODELS.get(number));
        known.map_or_else(|| format!("number {number}"), |(name, _)| name.to_string())
    }

    /// COLMAP's name for this model.
    pub fn own_name(self) -> &'static str {
        MODELS.iter().find(|(_, model)| *model == Some(self)).map_or("unknown", |(name, _)| name)
    }

    /// The model with a COLMAP name; `None` if it is not supported.
    pub fn by_name(name: &str) -> Option<Self> {
        MODELS.iter().find(|(known, _)| *known == name)?.1
    }
}
