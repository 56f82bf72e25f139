//! Decides which effects are simulated, from a [`Survey`] and fixed thresholds.
//!
//! `docs/EFFECTS.md` explains the thresholds by figures of captures with and without each effect.

mod colour;

use serde::Serialize;

pub use self::colour::{BRIGHTNESS_STOPS, GRADED, PLACES_LEAVE, VIEW_DEPENDENT_SHARE, WHITE_BALANCE_STOPS};
use super::EffectKind;
use super::survey::{DepthEvidence, ObservationSource, PoseSource, ShutterEvidence, Survey};

/// Threshold of the ratio between the largest and the smallest size of a point, exceeded by a twentieth of the points.
pub const FOOTPRINT_RATIO: f64 = 8.0;

/// Threshold of the mean reprojection error, px. Larger errors blur a scene.
pub const POSE_PX: f64 = 1.0;

/// Largest share of the reprojection error that a rolling shutter may leave to count as its cause. The share is large to
/// leave room for other errors.
pub const ROWS_LEAVE: f64 = 0.5;

/// Number of photographs below which much of a scene is undetermined.
pub const FEW_VIEWS: usize = 8;

/// Threshold of the share of points that are too far away for parallax.
pub const FAR_SHARE: f64 = 0.1;

/// Threshold of the sharpness of the least sharp twentieth of the photographs, divided by the median sharpness.
pub const BLUR_RATIO: f64 = 0.7;

/// Threshold of the sharpness around the points of a photograph, divided by that around the same points in others. Photographs that show
/// other things differ in sharpness without blur.
pub const SAME_BLUR_RATIO: f64 = 0.7;

const VIEW_DEPENDENCE: &str = "view-dependence";

/// The outcome of a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EffectVerdict {
    /// The effect is simulated.
    On,
    /// The effect is not needed.
    Off,
    /// Set by a separate option, whatever the capture shows.
    AsConfigured,
}

/// The decision on an effect, or a remark on something that cannot be switched.
#[derive(Clone, Debug, Serialize)]
pub struct Decision {
    /// The name: an [`EffectKind`]'s or another.
    pub name: &'static str,
    /// The effect that is switched. `None` for remarks.
    #[serde(skip)]
    pub effect: Option<EffectKind>,
    /// The outcome.
    pub verdict: EffectVerdict,
    /// The findings, in words.
    pub evidence: String,
    /// The condition for the effect.
    pub rule: String,
}

/// A decision on each effect, and remarks on what cannot be switched.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// Effects first.
    pub decisions: Vec<Decision>,
}

impl Plan {
    /// Whether an effect is on.
    pub fn has(&self, effect: EffectKind) -> bool {
        self.decisions.iter().any(|decision| decision.effect == Some(effect) && decision.verdict == EffectVerdict::On)
    }

    /// The degree of the spherical harmonics that the colours call for: 0 if they do not depend on the view. `None` if they
    /// do, or if nothing is known: the user's value or the default then applies.
    pub fn sh_degree(&self) -> Option<usize> {
        let matte = |decision: &Decision| decision.name == VIEW_DEPENDENCE && decision.verdict == EffectVerdict::Off;
        self.decisions.iter().any(matte).then_some(0)
    }

    /// The effects that are on.
    pub fn effects(&self) -> Vec<EffectKind> {
        EffectKind::ALL.into_iter().filter(|&effect| self.has(effect)).collect()
    }
}

impl From<&Survey> for Plan {
    fn from(survey: &Survey) -> Self {
        let decisions = vec![
            colour::view_dependence(survey),
            antialias(survey),
            alpha(survey),
            colour::exposure(survey),
            colour::bilateral_grid(survey),
            masks(survey),
            pose(survey),
            environment(survey),
            depth(survey),
            lens(survey),
            motion_blur(survey),
            rolling_shutter(survey),
        ];
        Self { decisions }
    }
}

fn decide(effect: EffectKind, on: bool, evidence: String, rule: String) -> Decision {
    let verdict = if on { EffectVerdict::On } else { EffectVerdict::Off };
    Decision { name: effect.name(), effect: Some(effect), verdict, evidence, rule }
}

/// The verdict and the words of `judge` on what was found, or that it is not known.
fn known<T>(found: &Option<T>, missing: &str, judge: impl FnOnce(&T) -> (bool, String)) -> (bool, String) {
    found.as_ref().map_or_else(|| (false, format!("not known: {missing}")), judge)
}

fn percent(share: f64) -> String {
    format!("{:.1}%", 100.0 * share)
}

fn antialias(survey: &Survey) -> Decision {
    let rule = format!("on if the sizes of a twentieth of the points differ by a factor above {FOOTPRINT_RATIO}");
    let (on, evidence) = known(&survey.footprint, "no point is visible in several photographs", |found| {
        let evidence = format!(
            "the sizes of a point differ by a factor of {:.1} (median), for a twentieth by {:.1} or more",
            found.median_ratio, found.largest_ratio
        );
        (found.largest_ratio > FOOTPRINT_RATIO, evidence)
    });
    decide(EffectKind::Antialias, on, evidence, rule)
}

fn alpha(survey: &Survey) -> Decision {
    let with = survey.files.with_alpha;
    let evidence = match with {
        0 => "every photograph is opaque".into(),
        _ => format!("{with} photographs have transparent pixels, or an alpha channel that was not decoded"),
    };
    let rule = "on if a photograph has an alpha channel that is not opaque".into();
    decide(EffectKind::Alpha, with > 0, evidence, rule)
}

fn masks(survey: &Survey) -> Decision {
    let files = &survey.files;
    let evidence = match files.with_mask {
        0 => "no folder `masks` or `mask` has a file for a photograph".into(),
        with => format!(
            "{with} of {} photographs have a mask; they exclude {} of their pixels",
            survey.views,
            percent(files.masked_share)
        ),
    };
    let rule = "on if a photograph has a mask".into();
    decide(EffectKind::Masks, files.with_mask > 0, evidence, rule)
}

/// The lens is not switched: it is part of the camera, and a capture without one uses kernels without one.
fn lens(survey: &Survey) -> Decision {
    let lens = &survey.lens;
    let names = lens.models.join(", ");
    let (on, evidence) = match lens.largest_displacement_px {
        Some(0.0) => (false, format!("{names}: straight lines stay straight")),
        Some(px) => (true, format!("{names}: the lens displaces points by up to {px:.1} px")),
        None => (true, format!("{names}: the field of view exceeds that of any pinhole (90° from the axis)")),
    };
    let rule =
        "on if the camera models have a lens: the scene is projected through it, and photographs are not undistorted"
            .into();
    let verdict = if on { EffectVerdict::On } else { EffectVerdict::Off };
    Decision { name: "lens", effect: None, verdict, evidence, rule }
}

/// Whether poses are wrong and a rolling shutter explains the reprojection errors better than other poses do.
fn rows_explain(survey: &Survey) -> bool {
    let wrong = survey.pose.as_ref().is_some_and(|pose| pose.mean_px > POSE_PX);
    let rows = |found: &ShutterEvidence| found.left_by_rows < ROWS_LEAVE && found.left_by_rows < found.left_by_poses;
    wrong && survey.shutter.as_ref().is_some_and(rows)
}

fn rolling_shutter(survey: &Survey) -> Decision {
    let rule = format!(
        "on if the mean reprojection error exceeds {POSE_PX} px, and camera motion during readout leaves less than {} of it and \
         less than other poses do",
        percent(ROWS_LEAVE)
    );
    let (on, evidence) = known(&survey.shutter, "no tracks", |found| {
        let [rows, poses] = [found.left_by_rows, found.left_by_poses].map(percent);
        let evidence =
            format!("camera motion during readout would leave {rows} of the reprojection error, other poses {poses}");
        (rows_explain(survey), evidence)
    });
    decide(EffectKind::RollingShutter, on, evidence, rule)
}

fn pose(survey: &Survey) -> Decision {
    let rule = format!("on if the mean reprojection error exceeds {POSE_PX} px and no rolling shutter causes it");
    let (on, evidence) = known(&survey.pose, "no reprojection error", |pose| {
        let source = match pose.source {
            PoseSource::Tracks => "measured on the tracks",
            PoseSource::Stated => "as the reconstruction states",
        };
        let (mean, largest) = (pose.mean_px, pose.largest_px);
        let evidence =
            format!("mean reprojection error {mean:.2} px, a twentieth of the errors above {largest:.2} px ({source})");
        (mean > POSE_PX && !rows_explain(survey), evidence)
    });
    decide(EffectKind::PoseRefinement, on, evidence, rule)
}

fn environment(survey: &Survey) -> Decision {
    let rule = format!(
        "on if more than {} of the points are that far away and no photograph has transparent parts",
        percent(FAR_SHARE)
    );
    let (on, evidence) = known(&survey.depth, "no points", |depth| {
        let DepthEvidence { nearest, median, furthest, far_share } = depth;
        let evidence = format!(
            "depths from {nearest:.2} to {furthest:.2} (median {median:.2}) scene units; {} of the points lie beyond {} extents \
             of the cameras",
            percent(*far_share),
            DepthEvidence::FAR_EXTENTS
        );
        (*far_share > FAR_SHARE && survey.files.with_alpha == 0, evidence)
    });
    decide(EffectKind::Environment, on, evidence, rule)
}

fn depth(survey: &Survey) -> Decision {
    let rule = format!("on if there is a folder of depth maps, or tracks and fewer than {FEW_VIEWS} photographs");
    let few = survey.views < FEW_VIEWS && survey.source == ObservationSource::Tracks;
    let evidence = match &survey.files.depth_maps {
        None => format!("{} photographs, no depth maps", survey.views),
        Some(folder) => format!("{} photographs and depth maps in {folder:?}", survey.views),
    };
    decide(EffectKind::DepthSupervision, few || survey.files.depth_maps.is_some(), evidence, rule)
}

fn motion_blur(survey: &Survey) -> Decision {
    let rule = format!(
        "on if the least sharp twentieth has less than {BLUR_RATIO} of the median sharpness, and a twentieth less than {SAME_BLUR_RATIO} of \
         that of others around the same points"
    );
    let blur = &survey.blur;
    let (on, evidence) = match (blur.median, blur.least) {
        (Some(median), Some(least)) => {
            let name = blur.least_sharp.as_deref().unwrap_or_default();
            let same = blur.least_of_same.map_or("not known".into(), |same| format!("{same:.2}"));
            let evidence = format!(
                "sharpness {median:.2} (median), {least:.2} for the least sharp twentieth; the least sharp is {name:?}; relative to others \
                 around the same points {same}"
            );
            let differs = blur.least_of_same.is_none_or(|same| same < SAME_BLUR_RATIO);
            (least < BLUR_RATIO * median && differs, evidence)
        }
        _ => (false, "not known: no photograph has any detail".into()),
    };
    decide(EffectKind::MotionBlur, on, evidence, rule)
}

/// A sentence on how the photographs were compared.
pub fn source(survey: &Survey) -> String {
    match survey.source {
        ObservationSource::None => "no sparse points: photographs cannot be compared".into(),
        ObservationSource::Tracks => format!(
            "{} points compared through {} observations of the reconstruction's tracks",
            survey.points_compared, survey.observations_compared
        ),
        ObservationSource::Projection => format!(
            "no tracks: {} points projected into the photographs, {} observations that nothing seems to hide; some are wrong, which \
             medians bear",
            survey.points_compared, survey.observations_compared
        ),
    }
}
