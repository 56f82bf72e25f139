//! Decisions from the colours of the same points in several photographs.

use super::super::EffectKind;
use super::super::survey::{GradingEvidence, Survey, ViewDependenceEvidence};
use super::{Decision, EffectVerdict, VIEW_DEPENDENCE, decide, known, percent};

/// Threshold of the brightness differences between photographs, stops of stored values (deviation). Surfaces also look
/// brighter from some sides than from others, so a smaller difference may belong to the scene.
pub const BRIGHTNESS_STOPS: f64 = 0.2;

/// Threshold of the white balance differences, stops of stored values (deviation). Hardly any surface changes its hue with
/// the viewing direction.
pub const WHITE_BALANCE_STOPS: f64 = 0.1;

/// Smallest residual of one colour map for each photograph, in display-referred values. It is five levels of 255, the
/// smallest visible difference.
pub const GRADED: f64 = ViewDependenceEvidence::VISIBLE;

/// Largest share of that residual that varying maps may leave. Real captures keep 86% and more, plain demos all of it. The
/// part that comes from texture, where points miss by half a pixel, always stays.
pub const PLACES_LEAVE: f64 = 0.65;

/// Share of points with visibly view-dependent colour above which a scene has spherical harmonics. Demos without
/// view-dependent colour have up to 0.4%, all of it noise. Real captures have 1.2% and more.
pub const VIEW_DEPENDENT_SHARE: f64 = 0.005;

/// Smallest number of points for a decision on shares of half a percent.
const FEWEST_COMPARED: usize = 500;

const FEW_POINTS: &str = "too few points are visible in several photographs";

/// Decides on the degree of the spherical harmonics instead of an effect. Missing harmonics cost more than idle ones, so
/// the threshold is close above the share that scenes without view-dependent colour show (`docs/EFFECTS.md`).
pub(super) fn view_dependence(survey: &Survey) -> Decision {
    let (verdict, evidence) = match &survey.view_dependence {
        Some(found) if found.points >= FEWEST_COMPARED => {
            let evidence = format!(
                "{} of {} points differ from their median colour by more than {} (of 1) in a third of their photographs, after \
                 exposure correction",
                percent(found.visible_share),
                found.points,
                ViewDependenceEvidence::VISIBLE
            );
            (if found.visible_share > VIEW_DEPENDENT_SHARE { EffectVerdict::On } else { EffectVerdict::Off }, evidence)
        }
        _ => (EffectVerdict::AsConfigured, format!("not known: fewer than {FEWEST_COMPARED} points could be compared")),
    };
    let rule = format!(
        "harmonics if more than {} of the points differ, else one colour for all directions; `--sh-degree` overrides this",
        percent(VIEW_DEPENDENT_SHARE)
    );
    Decision { name: VIEW_DEPENDENCE, effect: None, verdict, evidence, rule }
}

pub(super) fn exposure(survey: &Survey) -> Decision {
    let rule = format!(
        "on if brightness differs by more than {BRIGHTNESS_STOPS} stops or white balance by more than {WHITE_BALANCE_STOPS}, \
         unless `bilateral-grid` is on"
    );
    let (on, evidence) = known(&survey.exposure, FEW_POINTS, |found| {
        let (brightness, white_balance) = (found.brightness_spread_stops, found.white_balance_spread_stops);
        let evidence = format!(
            "photographs differ by {brightness:.3} stops of stored values in brightness, {white_balance:.3} in white balance \
             (deviation)"
        );
        (brightness > BRIGHTNESS_STOPS || white_balance > WHITE_BALANCE_STOPS, evidence)
    });
    decide(EffectKind::Exposure, on && !is_graded(survey), evidence, rule)
}

/// Whether colours vary within photographs and varying maps explain enough of the differences.
fn is_graded(survey: &Survey) -> bool {
    let graded = |found: &GradingEvidence| {
        found.left_by_maps > GRADED && found.left_by_places < PLACES_LEAVE * found.left_by_maps
    };
    survey.grading.as_ref().is_some_and(graded)
}

/// Decides on bilateral grids, which are the stronger form of exposures and replace them.
pub(super) fn bilateral_grid(survey: &Survey) -> Decision {
    let (on, evidence) = known(&survey.grading, FEW_POINTS, |found| {
        let evidence = format!(
            "one colour map for each photograph leaves a median difference of {:.4} (of 1), maps that vary within the \
             photograph {} of that",
            found.left_by_maps,
            percent(found.left_by_places / found.left_by_maps.max(f64::MIN_POSITIVE))
        );
        (is_graded(survey), evidence)
    });
    let rule = format!(
        "on if one map for each photograph leaves more than {GRADED}, and maps that vary within the photograph less than \
         {} of that",
        percent(PLACES_LEAVE)
    );
    decide(EffectKind::BilateralGrid, on, evidence, rule)
}
