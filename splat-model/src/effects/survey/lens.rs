//! Lenses.

use serde::Serialize;
use splat_op::CameraModel;

use super::Capture;

/// What the cameras say of their lenses.
#[derive(Clone, Debug, Serialize)]
pub struct LensEvidence {
    /// The models in use.
    pub models: Vec<String>,
    /// How far a lens moves a place in the picture at most, px; none if that is not known of a model.
    pub largest_displacement_px: Option<f64>,
}

pub(super) fn evidence(capture: &Capture) -> LensEvidence {
    let mut models: Vec<String> = Vec::new();
    let mut largest_displacement_px = Some(0.0_f64);
    for view in &capture.views {
        let (name, displacement_px) = match view.intrinsics.model {
            CameraModel::Pinhole => ("pinhole".to_owned(), Some(0.0)),
            other => (format!("{other:?}").to_lowercase(), None),
        };
        largest_displacement_px = largest_displacement_px.zip(displacement_px).map(|(a, b)| a.max(b));
        if !models.contains(&name) {
            models.push(name);
        }
    }
    LensEvidence { models, largest_displacement_px }
}
