//! Tests on demo captures, whose effects are known.

use tempfile::TempDir;

use super::*;
use crate::capture::testing::real_capture;
use crate::effects::plan::{Decision, EffectVerdict};
use crate::effects::{EffectKind, Plan};
use splat_demo::{self as demo, DemoOptions};

const SMALL: DemoOptions =
    DemoOptions { width: 128, height: 96, views: 16, points: 3000, seed: 3, ..DemoOptions::PLAIN };

fn survey_of(options: &DemoOptions) -> (TempDir, Capture, Survey) {
    let folder = tempfile::tempdir().unwrap();
    demo::write(folder.path(), options).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    let survey = Survey::of(&capture).unwrap();
    (folder, capture, survey)
}

fn effects(survey: &Survey) -> Vec<EffectKind> {
    Plan::from(survey).effects()
}

#[test]
fn all_files_that_a_run_may_read_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { views: 2, width: 16, height: 16, points: 9, masks: true, depth: true, ..SMALL };
    demo::write(folder.path(), &options).unwrap();
    std::fs::write(folder.path().join("scale.json"), "{\"metres_per_unit\": 2.0, \"source\": \"\"}").unwrap();
    std::fs::write(folder.path().join("depth/more.png"), "no photograph has this name").unwrap();
    let mut found = input_files(&Capture::load(folder.path()).unwrap());
    found.sort();
    let model = ["cameras", "images", "points3D"].map(|name| format!("sparse/0/{name}.bin"));
    let files = ["depth/0000.png", "depth/0001.png", "depth/depth.json", "images/0000.png", "images/0001.png"];
    let files = files.into_iter().chain(["masks/0001.png", "scale.json"]).map(String::from).chain(model);
    assert_eq!(found, files.map(|name| folder.path().join(name)).collect::<Vec<_>>());
}

#[test]
fn a_matte_scene_under_one_exposure_calls_for_nothing() {
    let (_folder, _, survey) = survey_of(&SMALL);
    assert_eq!(survey.source, ObservationSource::Tracks);
    assert!(survey.points_compared > 2000, "{}", survey.points_compared);
    let exposure = survey.exposure.as_ref().unwrap();
    assert!(exposure.brightness_spread_stops < 0.003 && exposure.white_balance_spread_stops < 0.003, "{exposure:?}");
    let pose = survey.pose.as_ref().unwrap();
    assert!(pose.source == PoseSource::Tracks && pose.largest_px < 1e-3, "{pose:?}");
    assert_eq!(survey.lens.largest_displacement_px, Some(0.0));
    assert_eq!(effects(&survey), []);
}

#[test]
fn exposures_are_found_photograph_by_photograph() {
    let options = DemoOptions { exposure: true, ..SMALL };
    let (_folder, capture, survey) = survey_of(&options);
    assert_eq!(effects(&survey), [EffectKind::Exposure]);
    // The gains apply to light and the stops to stored values, which are not linear in light: the order is the same, the
    // size is not.
    let gains = demo::gains(&options);
    let views = survey.exposure.unwrap().views;
    assert_eq!(views.len(), capture.views.len());
    for channel in 0..3 {
        let mut expected: Vec<f64> = gains.iter().map(|gain| gain[channel].log2()).collect();
        let middle = quantile(&mut expected.clone(), 0.5).unwrap();
        expected.iter_mut().for_each(|stops| *stops -= middle);
        for (view, expected) in views.iter().zip(expected) {
            let found = view.stops_rgb[channel];
            let ratio = if expected.abs() > 0.1 { found / expected } else { 0.35 };
            assert!((0.15..0.5).contains(&ratio), "{}: {found} stops for {expected} stops of light", view.name);
        }
    }
}

/// A difference that is constant over a photograph, or belongs to the surface instead of the position in the picture, is
/// not local processing.
#[test]
fn grading_is_told_from_exposure_and_gloss() {
    let found = |options| survey_of(&options).2.grading.unwrap();
    for options in [SMALL, DemoOptions { exposure: true, ..SMALL }, DemoOptions { glossy: true, ..SMALL }] {
        let one_map = found(options);
        assert!(one_map.left_by_places > 0.8 * one_map.left_by_maps, "{one_map:?}");
    }
    let graded = found(DemoOptions { graded: true, ..SMALL });
    assert!(graded.left_by_maps > 0.03 && graded.left_by_places < 0.5 * graded.left_by_maps, "{graded:?}");
    // Too few points for a fit.
    let (_folder, _, few) = survey_of(&DemoOptions { points: 30, ..SMALL });
    assert!(few.grading.is_none());
}

#[test]
fn a_grid_stands_in_for_exposures_where_it_is_called_for() {
    let (_folder, _, mut survey) = survey_of(&DemoOptions { exposure: true, ..SMALL });
    let mut decided = |left_by_maps, left_by_places| {
        survey.grading = Some(GradingEvidence { left_by_maps, left_by_places });
        effects(&survey)
    };
    assert_eq!(decided(0.03, 0.015), [EffectKind::BilateralGrid]);
    assert_eq!(decided(0.03, 0.025), [EffectKind::Exposure], "maps that vary explain little more");
    assert_eq!(decided(0.015, 0.001), [EffectKind::Exposure], "too little to see");
    assert_eq!(decided(0.0, 0.0), [EffectKind::Exposure]);
}

/// One point with these colours in the photographs, whose exposures add these logarithms.
fn seen(colours: &[f32], exposures: &[f64], spread: f32) -> (observations::PointObservations, exposure::Fit) {
    let observation = |(view, &colour): (usize, &f32)| observations::PointObservation {
        view,
        at_px: [9.0; 2],
        depth: 1.0,
        footprint: 1.0,
        sample: Some(observations::ColourSample {
            mean: [colour; 3],
            low: [colour - spread; 3],
            high: [colour + spread; 3],
            detail: None,
        }),
    };
    let points = vec![colours.iter().enumerate().map(observation).collect()];
    let observations = observations::PointObservations { source: ObservationSource::Tracks, points, indices: vec![0] };
    let views: Vec<_> = exposures.iter().map(|&exposure| Some([exposure; 3])).collect();
    (observations, exposure::Fit { counts: vec![20; views.len()], views })
}

#[test]
fn colours_that_change_with_the_view_are_told_from_exposure_and_neighbours() {
    let stray = |colours: &[f32], exposures: &[f64], spread| {
        let (observations, fit) = seen(colours, exposures, spread);
        view_dependence::evidence(&observations, &fit).map(|found| (found.median, found.visible_share))
    };
    let none = [0.0; 9];
    assert_eq!(stray(&[0.4; 9], &none, 0.0).map(|found| found.1), Some(0.0));
    let shiny = [0.4, 0.4, 0.6, 0.6, 0.6, 0.6, 0.4, 0.4, 0.4];
    let (median, share) = stray(&shiny, &none, 0.0).unwrap();
    assert!(share == 1.0 && (median - 0.2).abs() < 1e-6, "{median}");
    assert_eq!(stray(&shiny, &none, 0.25).unwrap().1, 0.0, "a neighbour shows the same");
    let bright = (0.6_f64 / 0.4).ln();
    assert_eq!(
        stray(&shiny, &[0.0, 0.0, bright, bright, bright, bright, 0.0, 0.0, 0.0], 0.0).unwrap().1,
        0.0,
        "an exposure"
    );
    let mostly = [bright, bright, bright, bright, bright, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(
        stray(&[0.6, 0.6, 0.6, 0.6, 0.6, 0.4, 0.4, 0.4, 0.4], &mostly, 0.0).unwrap().1,
        0.0,
        "that of most photographs"
    );
    assert_eq!(
        stray(&[0.4, 0.4, 0.4, 0.9, 0.4, 0.4, 0.4, 0.4, 0.4], &none, 0.0).unwrap().1,
        0.0,
        "one photograph is no evidence"
    );
    assert!(stray(&shiny[..8], &none[..8], 0.0).is_none(), "nor are eight, of which three may be hidden");
    // Clipped values are all alike.
    let clipped = [0.99, 0.99, 0.99, 0.99, 0.6, 0.6, 0.6, 0.6, 0.6];
    assert!(stray(&clipped, &none, 0.0).is_none(), "too few are left");
}

/// Captures without tracks are compared by projection.
#[test]
fn without_tracks_points_are_projected() {
    let (_folder, mut capture, tracked) = survey_of(&DemoOptions { exposure: true, ..SMALL });
    capture.tracks = Default::default();
    let survey = Survey::of(&capture).unwrap();
    assert_eq!(survey.source, ObservationSource::Projection);
    assert!(survey.pose.is_none());
    assert!(survey.exposure.as_ref().unwrap().white_balance_spread_stops > 0.06);
    for (view, tracked) in survey.exposure.unwrap().views.iter().zip(tracked.exposure.unwrap().views) {
        assert!((view.stops() - tracked.stops()).abs() < 0.08, "{view:?} {tracked:?}");
    }
    capture.points = Default::default();
    let survey = Survey::of(&capture).unwrap();
    assert_eq!(
        (survey.source, survey.exposure.is_some(), survey.footprint.is_some()),
        (ObservationSource::None, false, false)
    );
    assert_eq!(effects(&survey), []);
}

/// With a pinhole's projection, the poses of this capture would have errors of more than a pixel.
#[test]
fn poses_are_judged_through_the_lens() {
    let Some(folder) = real_capture("fox_distorted") else { return };
    let capture = Capture::load(&folder).unwrap();
    let survey = Survey::of_views(&capture, &[3, 4, 5]).unwrap();
    let pose = survey.pose.as_ref().unwrap();
    assert!(pose.source == PoseSource::Tracks && (0.2..0.5).contains(&pose.mean_px), "{pose:?}");
    let displacement = survey.lens.largest_displacement_px.unwrap();
    assert!((1.0..20.0).contains(&displacement), "{displacement}");
    assert_eq!((survey.views, survey.views_surveyed), (50, 3));
    assert_eq!(effects(&survey), []);
}

/// Keypoints of a damaged file may be anywhere.
#[test]
fn keypoints_far_outside_are_passed_over() {
    let (_folder, mut capture, _) = survey_of(&DemoOptions { views: 4, points: 60, ..SMALL });
    let mut tracks = crate::capture::Tracks::default();
    for point in 0..60 {
        let at_px = [f32::MAX, -f32::MAX, 1e19, -0.5][point % 4];
        let observations = (0..4).map(|view| crate::capture::Observation { view, at_px: [at_px, 30.0] });
        tracks.push(observations, 0.5);
    }
    capture.tracks = tracks;
    let survey = Survey::of(&capture).unwrap();
    assert!(survey.exposure.is_none() && survey.view_dependence.is_none());
    assert!(survey.pose.unwrap().mean_px > 1e6);
}

#[test]
fn statue_wild_has_masks_and_exposures() {
    let Some(root) = real_capture("statue_wild") else { return };
    let survey = Survey::of(&Capture::load(&root).unwrap()).unwrap();
    assert_eq!(effects(&survey), [EffectKind::Exposure, EffectKind::Masks]);
    assert!(survey.exposure.unwrap().brightness_spread_stops > 0.2);
    assert_eq!(survey.files.with_mask, 84);
    assert!((0.5..0.9).contains(&survey.files.masked_share), "{}", survey.files.masked_share);
}

#[test]
fn quantiles_and_deviations() {
    assert_eq!(quantile(&mut [3.0, 1.0, 2.0], 0.5), Some(2.0));
    assert_eq!(quantile(&mut [], 0.5), None);
    assert_eq!(deviation(&[1.0, 3.0]), 1.0);
    assert_eq!(deviation(&[]), 0.0);
}

/// All decisions that are on, except spherical harmonics: other faults of photographs make colours vary too.
fn called_for(survey: &Survey) -> Vec<&'static str> {
    let decisions = Plan::from(survey).decisions;
    let shown = |decision: &&Decision| decision.verdict == EffectVerdict::On && decision.name != "view-dependence";
    decisions.iter().filter(shown).map(|decision| decision.name).collect()
}

#[test]
fn harmonics_are_for_colours_that_depend_on_the_view() {
    // Smaller pictures show too little of a point for a threshold of half a percent.
    let usual = DemoOptions { width: 160, height: 120, views: 24, ..DemoOptions::default() };
    let (_folder, _, matte) = survey_of(&usual);
    assert_eq!(Plan::from(&matte).sh_degree(), Some(0), "{matte:#?}");
    let (_folder, _, glossy) = survey_of(&DemoOptions { glossy: true, ..usual });
    assert_eq!(Plan::from(&glossy).sh_degree(), None, "{glossy:#?}");
    // Too few points for a decision.
    let (_folder, _, few) = survey_of(&DemoOptions { points: 50, ..SMALL });
    let plan = Plan::from(&few);
    assert_eq!((plan.decisions[0].verdict, plan.sh_degree()), (EffectVerdict::AsConfigured, None));
}

/// A capture for each effect, in which exactly that effect is present.
#[test]
fn each_effect_of_the_demo_calls_for_itself_alone() {
    let wide = DemoOptions { views: 24, ..SMALL };
    // Motion of some pixels there is half as many pixels in a picture of half the width.
    let large = DemoOptions { width: 240, height: 180, views: 11, ..SMALL };
    let cases = [
        (SMALL, ""),
        (DemoOptions { glossy: true, ..SMALL }, ""),
        (DemoOptions { exposure: true, ..SMALL }, "exposure"),
        (DemoOptions { graded: true, ..SMALL }, "bilateral-grid"),
        (DemoOptions { graded: true, exposure: true, ..SMALL }, "bilateral-grid"),
        (DemoOptions { lens: true, ..SMALL }, "lens"),
        (DemoOptions { fisheye: true, ..SMALL }, "lens"),
        (DemoOptions { masks: true, ..SMALL }, "masks"),
        (DemoOptions { alpha: true, ..SMALL }, "alpha"),
        (DemoOptions { zoom: true, ..wide }, "antialias"),
        (DemoOptions { poses: true, ..SMALL }, "pose-refinement"),
        (DemoOptions { far: true, ..wide }, "environment"),
        (DemoOptions { motion: true, ..large }, "motion-blur"),
        // Plain walls nearby are less sharp than many houses far away.
        (DemoOptions { width: 96, height: 72, views: 48, points: 4000, ..DemoOptions::TOWN }, "antialias"),
        (DemoOptions { rolling: true, ..large }, "rolling-shutter"),
        (DemoOptions { depth: true, ..SMALL }, "depth-supervision"),
    ];
    for (options, expected) in cases {
        let (_folder, _, survey) = survey_of(&options);
        let expected: Vec<&str> = expected.split_terminator(' ').collect();
        assert_eq!(called_for(&survey), expected, "{options:?}\n{survey:#?}");
    }
}
