//! Whole runs on captures on which training is known to diverge.

use std::collections::BTreeMap;

use burn::tensor::Tensor;
use glam::DVec3;
use splat_demo::DemoOptions;
use splat_model::capture::{Photo, PointCloud};
use splat_model::density::AdaptiveConfig;
use splat_model::gaussians::GaussianRows;
use splat_model::optim::scene_extent;
use splat_model::trainer::{TrainConfig, Trainer};

use crate::case::{CaseOutcome, HardCase, Processor, TestDevice};
use crate::scratch::{TemporaryFolder, demo};

const DEMO: DemoOptions = DemoOptions { width: 40, height: 30, views: 6, points: 300, seed: 5, ..DemoOptions::PLAIN };

/// Steps of a run on a CPU.
const STEPS: usize = 500;
/// Steps of a run on a GPU. They are fewer than [`STEPS`] because the device may be a driver in software.
const GPU_STEPS: usize = 20;

/// Largest distance of a Gaussian from the cameras' middle, and its largest size, as a multiple of the larger of the scene extent
/// and the distance to the initial Gaussians.
const REACH: f64 = 3.0;

/// Largest magnitude of a colour coefficient, for colours from −1.4 to 2.4.
const LARGEST_COEFFICIENT: f32 = 7.0;

/// Largest ratio of the last losses to the first on a CPU, each the mean over the photographs: these differ by more than a short run
/// improves.
const LOSS_SHARE: f64 = 1.0;
/// [`LOSS_SHARE`] on a GPU, whose few steps hardly improve the hardest of these scenes.
const GPU_LOSS_SHARE: f64 = 1.2;

type Change = fn(&mut Vec<Photo>, &mut PointCloud);

pub fn cases() -> Vec<HardCase> {
    let of = |name: &str, why, change: Change| {
        HardCase::check(name, why, move |place| judge(place, change))
            .hardness(format!("{STEPS} steps, {GPU_STEPS} on a GPU"))
    };
    vec![
        of("training without points", "Gaussians begin at random, mostly wrong positions", |_, points| {
            *points = PointCloud::default();
        }),
        of("training on one photograph", "nothing constrains depth, and the cameras have no extent", |photos, _| {
            photos.truncate(1)
        }),
        of("training on duplicate cameras", "cameras at one place have contradictory photographs", |photos, _| {
            let first = photos[0].clone();
            photos.iter_mut().for_each(|photo| photo.cam_from_world = first.cam_from_world);
            photos.push(first);
        }),
        of(
            "training with a camera inside an object",
            "Gaussians surround the camera, at depths down to zero",
            |photos, points| {
                let pose = &mut photos[2].cam_from_world;
                // The camera moves to a point of the cloud, among its neighbours.
                let centre = DVec3::from_array(points.positions[0].map(f64::from));
                pose.translation = -(pose.matrix3 * centre);
            },
        ),
        of(
            "training with wildly wrong exposure",
            "photographs of one object are black, correctly exposed or white",
            |photos, _| {
                for (i, photo) in photos.iter_mut().enumerate() {
                    let gain = [0.0, 1.0, 20.0][i % 3];
                    photo.rgb.iter_mut().for_each(|value| *value = (f32::from(*value) * gain).min(255.0) as u8);
                }
            },
        ),
    ]
}

fn judge(place: &TestDevice, change: Change) -> CaseOutcome {
    let mut outcome = CaseOutcome::default();
    let mut run = || -> Result<(), Box<dyn std::error::Error>> {
        let scratch = TemporaryFolder::new()?;
        let (capture, mut photos) = demo(scratch.path(), &DEMO)?;
        let mut points = capture.points;
        change(&mut photos, &mut points);
        train(place, photos, &points, &mut outcome)
    };
    if let Err(error) = run() {
        outcome.failures.push(error.to_string());
    }
    outcome
}

fn train(
    place: &TestDevice,
    photos: Vec<Photo>,
    points: &PointCloud,
    outcome: &mut CaseOutcome,
) -> Result<(), Box<dyn std::error::Error>> {
    let (steps, share) = match place.processor {
        Processor::Cpu => (STEPS, LOSS_SHARE),
        Processor::Gpu => (GPU_STEPS, GPU_LOSS_SHARE),
    };
    // A short run with every event of a run of 30,000 steps: the SH degree grows, Gaussians come and go, opacities are reset.
    let density = AdaptiveConfig {
        every: steps / 10,
        from: steps / 10,
        // A run this short would end right after a reset, with a dark picture.
        reset_every: if place.processor == Processor::Gpu { 0 } else { steps / 3 },
        max_splats: 1_500,
        ..AdaptiveConfig::default()
    };
    let config = TrainConfig { steps, sh_every: steps / 8, density: density.into(), ..TrainConfig::default() };
    let centres: Vec<DVec3> = photos.iter().map(|photo| photo.cam_from_world.inverse().translation).collect();
    let middle = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let mut trainer = Trainer::new(photos, points, config, &place.device)?;
    let radius = |rows: &GaussianRows| {
        let distances = rows.means.iter().map(|mean| middle.distance(DVec3::from_array(mean.map(f64::from))));
        distances.fold(0.0, f64::max)
    };
    let reach = REACH * radius(&trainer.gaussians().to_rows()).max(scene_extent(&centres));
    let mut losses: Vec<(String, Tensor<1>)> = Vec::new();
    while !trainer.is_done() {
        let report = trainer.step()?;
        losses.push((report.view, report.loss));
    }
    let losses: Vec<_> = losses.into_iter().map(|(view, loss)| (view, loss.into_scalar::<f64>())).collect();
    outcome.require(losses.iter().all(|(_, loss)| loss.is_finite()), || "a loss is not finite".into());
    let last: BTreeMap<_, _> = losses.iter().cloned().collect();
    let first: BTreeMap<_, _> = losses.into_iter().rev().collect();
    let [first, last] = [first, last].map(|of| of.values().sum::<f64>() / of.len() as f64);
    outcome.require(last <= share * first, || format!("the loss went from {first:.4} to {last:.4}"));

    let rows = trainer.gaussians().to_rows();
    outcome.require(rows.unusable() == 0, || format!("{} of {} Gaussians are unusable", rows.unusable(), rows.len()));
    outcome.require(!rows.is_empty() && rows.len() <= 1_500, || format!("{} Gaussians are left", rows.len()));
    let (far, large) = (radius(&rows), rows.log_scales.as_flattened().iter().fold(f32::MIN, |a, b| a.max(*b)).exp());
    outcome.require(far <= reach, || format!("a Gaussian is {far:.1} from the cameras, of {reach:.1}"));
    outcome.require(f64::from(large) <= reach, || format!("a Gaussian is {large:.1} large, of {reach:.1}"));
    let coefficients = rows.sh_dc.as_flattened().iter().chain(&rows.sh_rest);
    let largest = coefficients.fold(0.0_f32, |largest, value| largest.max(value.abs()));
    outcome.require(largest <= LARGEST_COEFFICIENT, || format!("a coefficient is {largest}"));
    Ok(())
}
