//! No statistic that steers training follows a few bad rows: each is computed from a capture, and again after a twentieth of its cameras,
//! points, photographs, tracks or depths has been poisoned.

use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use splat_op::Intrinsics;

use crate::capture::{Capture, PointCloud, Tracks, origin, strays};
use crate::cleanup::Bulk;
use crate::effects::depth::{Depths, from_tracks};
use crate::effects::smoothing::Smoothing;
use crate::effects::{Plan, Survey};
use crate::gaussians::values_of;
use crate::init;
use crate::optim::{near_plane, scene_extent};
use splat_demo::{self as demo, DemoOptions};

const VIEWS: usize = 20;
const UTM: DVec3 = DVec3::new(500_123.25, 5_412_345.5, 312.125);

/// All statistics over rows that steer training, each positive, with the largest factor by which poison may change it. What is derived
/// from one by constants (learning rates, sizes for splitting and pruning, the scale of corrected poses) is not listed again.
fn statistics(capture: &Capture) -> Vec<(&'static str, f64, f64)> {
    let centre = |pose: &DAffine3| pose.inverse().translation;
    let poses: Vec<DAffine3> = capture.views.iter().map(|view| view.cam_from_world).collect();
    let centres: Vec<DVec3> = poses.iter().map(centre).collect();
    let cameras: Vec<(Intrinsics, DAffine3)> =
        capture.views.iter().map(|view| (view.intrinsics, view.cam_from_world)).collect();
    let extent = scene_extent(&centres);
    let moved: Vec<DAffine3> = poses.iter().map(|pose| origin::moved(pose, -UTM)).collect();
    let distance = |position: &[f32; 3]| DVec3::from(position.map(f64::from)).length();
    let random = init::random_points(&cameras, 400, &mut ChaCha8Rng::seed_from_u64(1));
    let farthest = random.positions.iter().map(distance).fold(0.0, f64::max);
    let start = init::distinct(&capture.points);
    let small = PointCloud {
        positions: [&start.positions[..]; 4].concat().iter().map(|point| point.map(|x| 1e-3 * x)).collect(),
        colours: vec![[0; 3]; 4 * start.positions.len()],
    };
    let mut sizes: Vec<f32> = init::from_points(&start).log_scales.iter().map(|log| log[0].exp()).collect();
    sizes.sort_by(f32::total_cmp);
    let least = init::from_points(&small).log_scales.iter().map(|log| log[0].exp()).fold(f32::INFINITY, f32::min);
    let filter = Smoothing::new(cameras.iter().map(|(camera, pose)| (camera, pose)));
    let unseen = [&start.positions[..], &[[0.0, 0.0, 1e9]]].concat();
    let unseen = Tensor::<1>::from_floats(unseen.as_flattened(), &Device::flex()).reshape([unseen.len(), 3]);
    let width_of_unseen = f64::from(values_of(filter.ln_widths(&unseen))[start.positions.len()].exp());
    let all: Vec<usize> = (0..capture.views.len()).collect();
    let mut samples = from_tracks(capture, &all);
    samples.iter_mut().flatten().step_by(20).for_each(|sample| sample.depth *= 1e-6);
    let depths = Depths::new(Default::default(), samples, &Device::flex());
    let survey = Survey::of(capture).unwrap();
    let (pose, shutter) = (survey.pose.clone().unwrap(), survey.shutter.unwrap());
    let depth = survey.depth.clone().unwrap();
    vec![
        ("extent", extent, 1.5),
        ("near plane of a scene of millimetres", near_plane(1e-3 * extent), 1.5),
        ("origin: extents from the cameras", 1.0 + origin::choose(&moved).distance(UTM) / extent, 1.5),
        ("random start: farthest point", farthest, 2.0),
        ("bounds of the points", Bulk::of(&start.positions).unwrap().width, 1.5),
        ("places of their own", start.positions.len() as f64, 1.1),
        ("size at the start: median", f64::from(sizes[sizes.len() / 2]), 1.5),
        ("size at the start: least", f64::from(least), 1.5),
        ("filter where no photograph looks", width_of_unseen, 3.0),
        ("largest weight of a known depth", 1.0 / depths.least(), 10.0),
        ("exposure: spread of brightness, stops", 0.1 + survey.exposure.unwrap().brightness_spread_stops, 2.0),
        ("colour maps: residual", survey.grading.unwrap().left_by_maps, 2.0),
        ("view-dependence: median", 0.01 + survey.view_dependence.unwrap().median, 2.0),
        ("footprint: ratio of a twentieth", survey.footprint.unwrap().largest_ratio, 2.0),
        ("reprojection error: mean, px", 0.1 + pose.mean_px, 8.0),
        ("rolling shutter: share left", 0.1 + shutter.left_by_rows, 2.0),
        ("other poses: share left", 0.1 + shutter.left_by_poses, 2.0),
        ("environment: depth of the scene", depth.median, 1.5),
        ("environment: share of far points", 0.1 + depth.far_share, 2.0),
        ("sharpness", survey.blur.median.unwrap(), 1.5),
    ]
}

fn demo_capture(folder: &Path) -> Capture {
    let small = DemoOptions { width: 96, height: 72, views: VIEWS, points: 1500, ..DemoOptions::default() };
    demo::write(folder, &small).unwrap();
    image::RgbImage::new(96, 72).save(folder.join("black.png")).unwrap();
    Capture::load(folder).unwrap()
}

#[test]
fn a_twentieth_of_bad_rows_moves_no_statistic_and_no_decision() {
    let folder = tempfile::tempdir().unwrap();
    let clean = demo_capture(folder.path());
    let black = folder.path().join("black.png");
    let expected = statistics(&clean);
    let decided = Plan::from(&Survey::of(&clean).unwrap()).effects();
    let points = |change: &dyn Fn(usize, &mut [f32; 3])| {
        let mut capture = clean.clone();
        capture.points.positions.iter_mut().enumerate().step_by(20).for_each(|(i, point)| change(i, point));
        capture
    };
    let camera = |pose: DAffine3| {
        let mut capture = clean.clone();
        capture.views[7].cam_from_world = pose;
        strays::leave_out(capture)
    };
    let photograph = |path: &PathBuf| {
        let mut capture = clean.clone();
        capture.views[7].image_path.clone_from(path);
        capture
    };
    let mut tracks = Tracks::default();
    for point in 0..clean.points.positions.len() {
        let wrong = |observation: &crate::capture::Observation| {
            let at_px = if point % 20 == 0 { observation.at_px.map(|px| 96.0 - px) } else { observation.at_px };
            crate::capture::Observation { at_px, ..*observation }
        };
        tracks.push(clean.tracks.of(point).iter().map(wrong).collect::<Vec<_>>(), 0.1);
    }
    let far = |i: usize, point: &mut [f32; 3]| *point = [1e6, -2e6, 1e6 * (1.0 + (i as f32).sin())];
    let poisoned = [
        ("cameras far away", camera(DAffine3::from_translation(DVec3::new(3e6, 2e5, 5e6)))),
        ("cameras at zero", camera(DAffine3::IDENTITY)),
        ("points far away", points(&far)),
        ("points at zero", points(&|_, point| *point = [0.0; 3])),
        ("points that are NaN", points(&|_, point| *point = [f32::NAN; 3])),
        ("photographs that are black", photograph(&black)),
        ("wrong tracks", Capture { tracks, ..clean.clone() }),
    ];
    let mut wrong = Vec::new();
    for (poison, capture) in &poisoned {
        for ((name, before, most), (_, after, _)) in expected.iter().zip(statistics(capture)) {
            if !(after <= before * most && after >= before / most) {
                wrong.push(format!("{poison}: {name} is {after} instead of {before}"));
            }
        }
        let effects = Plan::from(&Survey::of(capture).unwrap()).effects();
        if effects != decided {
            wrong.push(format!("{poison}: the effects are {effects:?} instead of {decided:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
