//! Evidence of the effects that a capture shows, gathered in seconds from its sparse reconstruction and its pictures.
//!
//! Colours are compared at places that several photographs show: the tracks of the reconstruction where it has any, else
//! points projected into the photographs, of which those are left out that something nearer seems to hide. Nothing here
//! decides anything; that is [`Plan`](super::Plan)'s.

mod blur;
mod depth;
mod exposure;
mod files;
mod footprint;
mod grading;
mod lens;
mod pictures;
mod pose;
mod shutter;
mod sights;
mod view_dependence;

#[cfg(test)]
mod tests;

use serde::Serialize;

use crate::capture::{Capture, CaptureError};

pub use self::blur::BlurEvidence;
pub use self::depth::DepthEvidence;
pub use self::exposure::{ExposureEvidence, ViewExposure};
pub use self::files::{FileEvidence, depth_folder};
pub use self::footprint::FootprintEvidence;
pub use self::grading::GradingEvidence;
pub use self::lens::LensEvidence;
pub use self::pose::{PoseEvidence, PoseSource};
pub use self::shutter::ShutterEvidence;
pub use self::sights::SightSource;
pub use self::view_dependence::ViewDependenceEvidence;

/// All that is known of a capture before training. Absent is what the capture does not let one know.
#[derive(Clone, Debug, Serialize)]
pub struct Survey {
    /// Photographs in the capture.
    pub views: usize,
    /// Of those, the ones that were looked at: all that were asked for, unless they have more pixels than
    /// [`Survey::MOST_PIXELS`].
    pub views_surveyed: usize,
    /// Pixels of a photograph, the mean over the capture.
    pub pixels_per_view: f64,
    /// Sparse points in the capture.
    pub points: usize,
    /// How photographs were matched.
    pub source: SightSource,
    /// Points that were compared, and how often one was seen in a picture.
    pub points_compared: usize,
    /// See [`Self::points_compared`].
    pub sights_compared: usize,
    /// Lenses.
    pub lens: LensEvidence,
    /// Brightness and white balance.
    pub exposure: Option<ExposureEvidence>,
    /// Whether they change over a picture.
    pub grading: Option<GradingEvidence>,
    /// Colours that depend on where they are seen from.
    pub view_dependence: Option<ViewDependenceEvidence>,
    /// How large the same thing is in different photographs.
    pub footprint: Option<FootprintEvidence>,
    /// How well the poses explain the pictures.
    pub pose: Option<PoseEvidence>,
    /// Whether what they do not explain is the cameras' motion while rows were read.
    pub shutter: Option<ShutterEvidence>,
    /// How far away things are.
    pub depth: Option<DepthEvidence>,
    /// Sharpness.
    pub blur: BlurEvidence,
    /// Alpha channels, masks and depth maps.
    pub files: FileEvidence,
}

impl Survey {
    /// Pixels that are decoded at most: about two seconds on two cores. Beyond it photographs are left out evenly.
    pub const MOST_PIXELS: usize = 150_000_000;

    /// Reads the pictures of `capture` and compares them.
    ///
    /// # Errors
    /// A [`CaptureError`] if a picture is missing, cannot be decoded, or has another size than its camera.
    pub fn of(capture: &Capture) -> Result<Self, CaptureError> {
        Self::of_views(capture, &(0..capture.views.len()).collect::<Vec<_>>())
    }

    /// The same, looking at the pictures of some views alone, indices in rising order: those to train on, where a decision must
    /// not rest on those to test on.
    ///
    /// # Errors
    /// Those of [`Self::of`].
    pub fn of_views(capture: &Capture, views: &[usize]) -> Result<Self, CaptureError> {
        let size = |&view: &usize| capture.views[view].intrinsics.width * capture.views[view].intrinsics.height;
        let pixels: usize = views.iter().map(size).sum();
        let every = pixels.div_ceil(Self::MOST_PIXELS).max(1);
        let surveyed: Vec<usize> = views.iter().copied().step_by(every).collect();
        let mut sights = sights::Sights::of(capture, &surveyed);
        let glances = pictures::look(capture, &surveyed, &mut sights)?;
        let fit = exposure::fit(&sights, capture.views.len());
        Ok(Self {
            views: capture.views.len(),
            views_surveyed: surveyed.len(),
            pixels_per_view: pixels as f64 / views.len().max(1) as f64,
            points: capture.points.positions.len(),
            source: sights.source,
            points_compared: sights.points.len(),
            sights_compared: sights.points.iter().map(Vec::len).sum(),
            lens: lens::evidence(capture),
            exposure: exposure::evidence(capture, &fit),
            grading: grading::evidence(capture, &sights),
            view_dependence: view_dependence::evidence(&sights, &fit),
            footprint: footprint::evidence(&sights),
            pose: pose::evidence(capture),
            shutter: shutter::evidence(capture),
            depth: depth::evidence(capture, &sights),
            blur: blur::evidence(capture, &glances),
            files: files::evidence(capture, views, &glances),
        })
    }
}

/// The value below which a share of `values` lies, none without values. Sorts them.
fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let at = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(at).copied()
}

/// The root of the mean square of the differences to the mean; 0 without values.
fn deviation(values: &[f64]) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}
