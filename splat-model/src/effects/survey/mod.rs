//! Evidence of the effects in a capture, gathered in seconds from its sparse reconstruction and its photographs.
//!
//! Colours are compared at points that several photographs show. The tracks of the reconstruction say which photographs
//! show a point. Without tracks, points are projected into the photographs, and those that a nearer point seems to hide are
//! left out. The survey decides nothing: decisions are made by [`Plan`](super::Plan).

mod blur;
mod depth;
mod detail;
mod exposure;
mod files;
mod footprint;
mod grading;
mod lens;
mod observations;
mod pictures;
mod pose;
mod selection;
mod shutter;
mod view_dependence;

#[cfg(test)]
mod tests;

use serde::Serialize;

use crate::capture::{Capture, Result};
use crate::quantile::quantile;

pub use self::blur::BlurEvidence;
pub use self::depth::DepthEvidence;
pub use self::detail::sharpness_of_grey;
pub use self::exposure::{ExposureEvidence, ViewExposure};
pub use self::files::{FileEvidence, input_files};
pub use self::footprint::FootprintEvidence;
pub use self::grading::GradingEvidence;
pub use self::lens::LensEvidence;
pub use self::observations::ObservationSource;
use self::observations::{ColourSample, PointObservation, PointObservations};
pub use self::pose::{PoseEvidence, PoseSource};
pub use self::shutter::ShutterEvidence;
pub use self::view_dependence::ViewDependenceEvidence;

/// The evidence of a capture before training. A value is `None` if the capture does not determine it.
#[derive(Clone, Debug, Serialize)]
pub struct Survey {
    /// Photographs in the capture.
    pub views: usize,
    /// Number of photographs that were decoded: all requested ones, unless they have more pixels than [`Survey::MOST_PIXELS`].
    pub views_surveyed: usize,
    /// Mean number of pixels per photograph.
    pub pixels_per_view: f64,
    /// Sparse points in the capture.
    pub points: usize,
    /// How the photographs of a point were found.
    pub source: ObservationSource,
    /// Number of compared points.
    pub points_compared: usize,
    /// Number of observations of the compared points in photographs.
    pub observations_compared: usize,
    /// Lens distortion.
    pub lens: LensEvidence,
    /// Brightness and white balance.
    pub exposure: Option<ExposureEvidence>,
    /// Local differences of colour within photographs.
    pub grading: Option<GradingEvidence>,
    /// View-dependent colour.
    pub view_dependence: Option<ViewDependenceEvidence>,
    /// Sizes of the same point in different photographs.
    pub footprint: Option<FootprintEvidence>,
    /// Reprojection errors.
    pub pose: Option<PoseEvidence>,
    /// How much of the reprojection errors a rolling shutter explains.
    pub shutter: Option<ShutterEvidence>,
    /// Depths of the scene.
    pub depth: Option<DepthEvidence>,
    /// Sharpness of the photographs.
    pub blur: BlurEvidence,
    /// Alpha channels, masks and depth maps.
    pub files: FileEvidence,
}

impl Survey {
    /// Largest number of decoded pixels: about two seconds on two cores. In larger captures, groups of photographs that show the
    /// same points are decoded.
    pub const MOST_PIXELS: usize = 150_000_000;

    /// Surveys all photographs of `capture`.
    ///
    /// # Errors
    /// A [`CaptureError`](crate::capture::CaptureError) if a picture is missing, cannot be decoded, or has another size than its camera.
    pub fn of(capture: &Capture) -> Result<Self> {
        Self::of_views(capture, &(0..capture.views.len()).collect::<Vec<_>>())
    }

    /// Surveys only the photographs `views`, indices in ascending order: for example the training views, if decisions must
    /// not depend on the held-out views.
    ///
    /// # Errors
    /// Errors of [`Self::of`].
    pub fn of_views(capture: &Capture, views: &[usize]) -> Result<Self> {
        capture.check_photographs(views)?;
        let size = |&view: &usize| capture.views[view].intrinsics.width * capture.views[view].intrinsics.height;
        let pixels: usize = views.iter().map(size).sum();
        let surveyed = selection::select(capture, views, Self::MOST_PIXELS);
        let mut observations = PointObservations::of(capture, &surveyed);
        let glances = pictures::look(capture, &surveyed, &mut observations)?;
        let fit = exposure::fit(&observations, capture.views.len());
        Ok(Self {
            views: capture.views.len(),
            views_surveyed: surveyed.len(),
            pixels_per_view: pixels as f64 / views.len().max(1) as f64,
            points: capture.points.positions.len(),
            source: observations.source,
            points_compared: observations.points.len(),
            observations_compared: observations.points.iter().map(Vec::len).sum(),
            lens: lens::evidence(capture),
            exposure: exposure::evidence(capture, &fit),
            grading: grading::evidence(capture, &observations),
            view_dependence: view_dependence::evidence(&observations, &fit),
            footprint: footprint::evidence(&observations),
            pose: pose::evidence(capture),
            shutter: shutter::evidence(capture),
            depth: depth::evidence(capture, &observations),
            blur: blur::evidence(capture, &glances, &observations),
            files: files::evidence(capture, views, &glances),
        })
    }
}

/// The standard deviation. 0 without values.
fn deviation(values: &[f64]) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}
