//! What is decided by the colours of the same points in several photographs.

use super::super::EffectKind;
use super::super::survey::{GradingEvidence, Survey, ViewDependenceEvidence};
use super::{Cost, Decision, MIB, VIEW_DEPENDENCE, Verdict, decide, percent};

/// Brightness differs by this many stops of stored values (deviation). Things look brighter from some sides than from others
/// too, so that a smaller difference may be the scene's.
pub const BRIGHTNESS_STOPS: f64 = 0.2;

/// White balance, the same: hardly anything changes its hue with the side that it is seen from.
pub const WHITE_BALANCE_STOPS: f64 = 0.1;

/// What one map of colours for each photograph leaves must be more than this, in display-referred values: five levels of 255, so
/// that there is something to see.
pub const GRADED: f64 = ViewDependenceEvidence::VISIBLE;

/// And maps that vary over the picture must leave less than this of it. Real captures are left 86% and more, plain demos all of it; what
/// texture makes of places that miss by half a pixel stays in any case.
pub const PLACES_LEAVE: f64 = 0.65;

/// Share of the points whose colours visibly depend on the view, from which on a scene has spherical harmonics. Matte demos have up to
/// 0.4%, of which none is real; real captures have 1.2% and more.
pub const VIEW_DEPENDENT_SHARE: f64 = 0.005;

/// Fewer points than this say nothing about shares of half a percent.
const FEWEST_COMPARED: usize = 500;

/// Times per step and megapixel, ms: measured, see `docs/EFFECTS.md`.
const EXPOSURE_MS_PER_MEGAPIXEL: f64 = 40.0;
const GRID_MS_PER_MEGAPIXEL: f64 = 2500.0;

/// Decides on the degree of the harmonics and not on an effect. Leaving them out of a scene that needs them costs more than having
/// them where they are idle, so that the threshold lies close above what matte scenes show (`docs/EFFECTS.md`).
pub(super) fn view_dependence(survey: &Survey) -> Decision {
    let (verdict, evidence) = match &survey.view_dependence {
        Some(found) if found.points >= FEWEST_COMPARED => {
            let evidence = format!(
                "{} of {} points stray by more than {} of 1 in a third of their photographs, after exposure is removed",
                percent(found.visible_share),
                found.points,
                ViewDependenceEvidence::VISIBLE
            );
            (if found.visible_share > VIEW_DEPENDENT_SHARE { Verdict::On } else { Verdict::Off }, evidence)
        }
        _ => (Verdict::AsConfigured, format!("not known: fewer than {FEWEST_COMPARED} points could be compared")),
    };
    let rule = format!(
        "harmonics where more than {} of the points stray, else one colour for all directions; `--sh-degree` overrules",
        percent(VIEW_DEPENDENT_SHARE)
    );
    Decision { name: VIEW_DEPENDENCE, effect: None, verdict, evidence, rule, predicted: None }
}

pub(super) fn exposure(survey: &Survey) -> Decision {
    let rule = format!(
        "on where brightness differs by more than {BRIGHTNESS_STOPS} stops or white balance by more than {WHITE_BALANCE_STOPS}, \
         unless `bilateral-grid` is"
    );
    let (on, evidence) = match &survey.exposure {
        None => (false, "not known: too few points are in several photographs".into()),
        Some(found) => {
            let on = found.brightness_spread_stops > BRIGHTNESS_STOPS
                || found.white_balance_spread_stops > WHITE_BALANCE_STOPS;
            let evidence = format!(
                "photographs differ by {:.3} stops of stored values in brightness, {:.3} in white balance (deviation)",
                found.brightness_spread_stops, found.white_balance_spread_stops
            );
            (on, evidence)
        }
    };
    // Parameters, two moments and a gradient of twelve numbers for each photograph.
    let mib = survey.views as f64 * 4.0 * 12.0 * 4.0 / MIB;
    let cost = Cost { ms_per_step: EXPOSURE_MS_PER_MEGAPIXEL * survey.pixels_per_view / 1e6, mib };
    decide(EffectKind::Exposure, on && !is_graded(survey), evidence, rule, Some(cost))
}

/// Whether colours change over the photographs, and what of the differences between them maps that do leave.
fn is_graded(survey: &Survey) -> bool {
    let graded = |found: &GradingEvidence| {
        found.left_by_maps > GRADED && found.left_by_places < PLACES_LEAVE * found.left_by_maps
    };
    survey.grading.as_ref().is_some_and(graded)
}

/// The stronger form of exposures, and instead of them.
pub(super) fn bilateral_grid(survey: &Survey) -> Decision {
    let evidence = match &survey.grading {
        None => "not known: too few points are in several photographs".into(),
        Some(found) => format!(
            "one map of colours for each photograph leaves differences of {:.4} of 1 (median), maps that vary over it {} of that",
            found.left_by_maps,
            percent(found.left_by_places / found.left_by_maps.max(f64::MIN_POSITIVE))
        ),
    };
    let rule = format!(
        "on where one map for each photograph leaves more than {GRADED}, and maps that vary over it less than {} of that",
        percent(PLACES_LEAVE)
    );
    let megapixels = survey.pixels_per_view / 1e6;
    // Parameters and two moments of 12 x 8 x 16 x 16 numbers for each photograph.
    let mib = survey.views as f64 * 3.0 * 24_576.0 * 4.0 / MIB;
    let cost = Cost { ms_per_step: GRID_MS_PER_MEGAPIXEL * megapixels, mib };
    decide(EffectKind::BilateralGrid, is_graded(survey), evidence, rule, Some(cost))
}
