//! The lists of a view, which a GPU writes with the length that recent views tell, while the host waits for the true one: no
//! expectation changes a bit of a run, and the device has work whenever the host waits for it. A process of its own, because
//! the hooks are global.

use std::sync::Mutex;

use burn::tensor::{DType, Device};
use glam::{DAffine3, DVec3};
use splat_model::accuracy::Setting;
use splat_model::capture::{Photo, PointCloud};
use splat_model::density::AdaptiveConfig;
use splat_model::gaussians::GaussianRows;
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::test_hooks::{expect_intersections, idle_waits, repeated_lists};
use splat_op::{Accumulation, Extras, Intrinsics, ListLength, RenderOptions, render, truncated_views};
use splat_tests::gpu;
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host};

const STEPS: u64 = 24;

/// Views of a step.
const BATCH: u64 = 2;

/// Four photographs of noise. The Gaussians fill more of the picture in each than in the one before.
fn photos() -> Vec<Photo> {
    let (width, height) = (96, 70);
    let byte = |i: usize| (i % 256) as u8;
    let photo = |view: usize| Photo {
        name: format!("{view}"),
        intrinsics: Intrinsics::centred(width, height, 90.0),
        cam_from_world: DAffine3::from_translation(DVec3::new(0.1 * view as f64, 0.0, 4.0 - 0.6 * view as f64)),
        rgb: (0..width * height).flat_map(|i| [byte(2 * i), byte(90 * view + i / 9), byte(i / 7)]).collect(),
        alpha: None,
        mask: None,
    };
    (0..4).map(photo).collect()
}

/// Expectations and counts are the process's.
static ALONE: Mutex<()> = Mutex::new(());

/// Trains with density control and ordered sums, so that the bits do not depend on the device's timing. Returns the rows, the
/// losses, the number of idle waits, and the number of repeated lists.
fn run(device: &Device, expected: Option<u64>) -> (GaussianRows, Vec<u32>, [u64; 2]) {
    expect_intersections(expected);
    let position = |i: usize| [(i % 20) as f32 / 10.0 - 0.9, (i / 20) as f32 / 10.0 - 0.7, (i % 3) as f32 / 4.0];
    let points = PointCloud { positions: (0..320).map(position).collect(), colours: vec![[90, 140, 60]; 320] };
    let density = AdaptiveConfig {
        every: 5,
        from: 5,
        grad_threshold: 1e-5,
        until_share: 0.9,
        max_splats: 500,
        ..AdaptiveConfig::default()
    };
    let config = TrainConfig {
        steps: STEPS as usize,
        batch: BATCH as usize,
        sh_every: 3,
        density: density.into(),
        dials: Setting::new([("accumulation", "ordered")]).expect("a dial and a value of it"),
        ..TrainConfig::default()
    };
    let mut run = Trainer::new(photos(), &points, config, device).expect("photographs and steps");
    let before = [idle_waits(), repeated_lists()];
    let losses = (0..STEPS).map(|_| run.step().expect("a sound run").loss.into_scalar::<f32>().to_bits()).collect();
    let counts = [idle_waits() - before[0], repeated_lists() - before[1]];
    (run.gaussians().untracked().to_rows(), losses, counts)
}

#[test]
fn a_step_waits_only_while_the_device_works_and_no_expected_length_changes_a_bit() {
    let Some(device) = gpu() else { return };
    let _alone = ALONE.lock();
    // Without an expected length, the host waits in each view for a device with nothing to do.
    let (rows, losses, counts) = run(&device, Some(0));
    assert!(rows.len() > 320, "{} of 320 Gaussians, nothing was added", rows.len());
    assert_eq!(counts, [STEPS * BATCH, 0]);
    let told_by_views = run(&device, None);
    println!("{} Gaussians; idle waits and repeated lists: {:?}", rows.len(), told_by_views.2);
    // All views are of one size, and the run before has seen it.
    assert_eq!(told_by_views.2[0], 0, "idle waits");
    assert!(told_by_views.2[1] < STEPS * BATCH / 8, "{} repeated lists", told_by_views.2[1]);
    // A list of one intersection is always too short, and one of a hundred thousand never.
    let short = run(&device, Some(1));
    assert_eq!(short.2, [0, STEPS * BATCH]);
    let long = run(&device, Some(100_000));
    assert_eq!(long.2, [0, 0]);
    for (what, found) in [("told by views", told_by_views), ("too short", short), ("too long", long)] {
        assert_eq!(found.1, losses, "the losses if the expected length is {what}");
        assert!(found.0 == rows, "the rows differ if the expected length is {what}");
    }
}

/// Renders a picture with depth. Returns colours, alphas, depths and the gradient of the means.
fn picture(device: &Device, options: &RenderOptions) -> [Vec<f64>; 4] {
    let scene = Scene::random(&mut Random::new(5), 1_000, 1, Intrinsics::centred(190, 130, 150.0));
    let SceneTensors { splats, camera, .. } = scene.tensors(&device.clone().autodiff(), DType::F32);
    let out = render(&splats, &[camera], &Extras::default(), options).expect("a valid scene");
    let depth = out.depth.expect("asked for");
    let grads = (out.colour.clone().mean() + depth.clone().mean()).backward();
    let means = splats.means.grad(&grads).expect("tracked");
    [host(out.colour), host(out.alpha), host(depth), host(means)]
}

/// The largest difference, as a share of the largest number.
fn difference(a: &[f64], b: &[f64]) -> f64 {
    let largest = a.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest
}

#[test]
fn lists_of_expected_length_wait_for_nothing_and_say_which_were_too_short() {
    let Some(device) = gpu() else { return };
    let _alone = ALONE.lock();
    let counted = RenderOptions::standard().with_depth(true);
    let expected = counted.with_lists(ListLength::Expected);
    // Before any view of so many tiles, the lists have room for a usual scene.
    expect_intersections(None);
    let before = truncated_views();
    let first = picture(&device, &expected);
    let is_whole = truncated_views() == before;
    let whole = picture(&device, &counted.with_accumulation(Accumulation::Ordered));
    assert_eq!(first[1] == whole[1], is_whole);
    for capacity in [None, Some(200_000)] {
        expect_intersections(capacity);
        let before = truncated_views();
        let found = picture(&device, &expected);
        assert_eq!(truncated_views() - before, 0, "{capacity:?}");
        assert_eq!(found[..3], whole[..3], "{capacity:?}: the picture");
        // Atomic sums differ in their last digits.
        assert!(difference(&found[3], &whole[3]) <= 1e-5, "{capacity:?}: the gradient");
    }
    // A render that waited for the true length would write the lists once more.
    let before = truncated_views();
    expect_intersections(Some(1_000));
    let found = picture(&device, &expected);
    assert_eq!(truncated_views() - before, 1);
    assert!(difference(&found[1], &whole[1]) > 0.1, "some Gaussians are left out");
    assert!(found.iter().flatten().all(|value| value.is_finite()));
    // Ordered sums are numbered by the true count.
    assert_eq!(picture(&device, &expected.with_accumulation(Accumulation::Ordered)), whole);
    // What was learned of the view serves the next.
    expect_intersections(None);
    let found = picture(&device, &expected);
    assert_eq!(truncated_views() - before, 1);
    assert_eq!(found[..3], whole[..3]);
}
