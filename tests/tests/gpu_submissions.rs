//! Where a submission ends, and what memory held before, changes no bit of a run on a GPU, and no loss of it is far from the CPU's.
//!
//! CubeCL submits after `CUBECL_WGPU_MAX_TASKS` launches. It reads the number when a device opens, so each has a process of its own.
//! `SPLAT_STEPS` is the number of steps of each run.

use std::env;
use std::process::Command;

use burn::tensor::Device;
use glam::{DAffine3, DVec3};
use sha2::{Digest, Sha256};
use splat_model::accuracy::Setting;
use splat_model::capture::{Photo, PointCloud};
use splat_model::density::AdaptiveConfig;
use splat_model::effects::background::Backdrop;
use splat_model::effects::depth::{DepthConfig, DepthSample};
use splat_model::effects::exposure::ExposureConfig;
use splat_model::effects::grid::GridConfig;
use splat_model::effects::optics::OpticsConfig;
use splat_model::effects::pose::PoseConfig;
use splat_model::optim::MomentBits;
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Intrinsics, test_hooks};
use splat_tests::gpu;

/// Marks the lines of a process that its parent compares.
const MARK: &str = "RUN ";

fn steps() -> usize {
    env::var("SPLAT_STEPS").ok().and_then(|steps| steps.parse().ok()).unwrap_or(12)
}

/// Three photographs of noise. One has a mask.
fn photos() -> Vec<Photo> {
    let (width, height) = (48, 36);
    let byte = |i: usize| (i % 256) as u8;
    let photo = |view: usize| Photo {
        name: format!("{view}"),
        intrinsics: Intrinsics::centred(width, height, 50.0),
        cam_from_world: DAffine3::from_translation(DVec3::new(0.1 * view as f64, 0.0, 3.0)),
        rgb: (0..width * height).flat_map(|i| [byte(2 * i), byte(90 * view + i / 9), byte(i / 7)]).collect(),
        alpha: None,
        mask: (view == 1).then(|| (0..width * height).map(|i| i % width < 30).collect()),
    };
    (0..3).map(photo).collect()
}

/// Runs that have all operations of training between them, with sums in a fixed order.
fn runs() -> Vec<(&'static str, TrainConfig)> {
    let density =
        AdaptiveConfig { every: 8, from: 8, grad_threshold: 1e-5, max_splats: 90, ..AdaptiveConfig::default() };
    let ordered = |others: &[(&str, &str)]| {
        let all = [&[("accumulation", "ordered")], others].concat();
        Setting::new(all).expect("dials and values of them")
    };
    let plain = TrainConfig {
        steps: steps(),
        sh_every: 5,
        density: density.into(),
        dials: ordered(&[]),
        opacity_weight: 0.01,
        ..TrainConfig::default()
    };
    let optics = OpticsConfig::default();
    vec![
        ("the scene alone", plain.clone()),
        (
            "exposures, poses, depths, an environment and motion",
            TrainConfig {
                exposure: Some(ExposureConfig::default()),
                poses: Some(PoseConfig::default()),
                depth: Some(DepthConfig::default()),
                backdrop: Backdrop::Environment { degree: 2 },
                optics: OpticsConfig { motion: true, ..optics },
                moment_bits: MomentBits::Eight,
                ..plain.clone()
            },
        ),
        (
            "grids, smoothing, a learned background and a rolling shutter",
            TrainConfig {
                grid: Some(GridConfig::default()),
                smoothing: true,
                antialias: true,
                backdrop: Backdrop::Learned,
                optics: OpticsConfig { rolling: true, ..optics },
                ..plain.clone()
            },
        ),
        ("along rays", TrainConfig { dials: ordered(&[("projection", "ray-max")]), ..plain }),
    ]
}

/// Trains, and returns the losses and the bits of losses and scene.
fn train(config: &TrainConfig, device: &Device) -> (Vec<f32>, String) {
    let position = |i: usize| [(i % 8) as f32 / 4.0 - 0.9, (i / 8) as f32 / 4.0 - 0.7, (i % 3) as f32 / 4.0];
    let points = PointCloud { positions: (0..48).map(position).collect(), colours: vec![[90, 140, 60]; 48] };
    let known = [([0.5, 0.5], 2.0), ([0.3, 0.4], 2.5)].map(|(at, depth)| DepthSample { at, depth });
    let run = Trainer::new(photos(), &points, config.clone(), device).expect("photographs and steps");
    let mut run = run.with_depths(vec![known.to_vec(); 3]);
    let losses: Vec<f32> = (0..config.steps).map(|_| run.step().expect("a sound run").loss.into_scalar()).collect();
    let rows = run.gaussians().untracked().to_rows();
    let bits: Vec<u32> = losses.iter().map(|loss| loss.to_bits()).collect();
    let digest = Sha256::digest(format!("{bits:x?} {rows:?}"));
    (losses, digest.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Prints a line for each run.
#[test]
#[ignore = "a process of the other test"]
fn child() {
    let Some(device) = gpu() else { return };
    test_hooks::poison(env::var_os("SPLAT_POISON").is_some());
    for (name, config) in runs() {
        let (losses, digest) = train(&config, &device);
        println!("{MARK}{name}: {digest} {losses:?}");
    }
}

/// Returns the lines of a process that submits after `tasks` launches.
fn lines(tasks: &str, poisoned: bool) -> Vec<String> {
    let mut process = Command::new(env::current_exe().expect("a program"));
    process.args(["--exact", "child", "--ignored", "--nocapture"]).env("CUBECL_WGPU_MAX_TASKS", tasks);
    if poisoned {
        process.env("SPLAT_POISON", "1");
    }
    let output = process.output().expect("it starts");
    assert!(output.status.success(), "{tasks}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("words");
    let lines: Vec<String> = text.lines().filter_map(|line| Some(line.split_once(MARK)?.1.to_owned())).collect();
    assert_eq!(lines.len(), runs().len(), "{text}");
    lines
}

#[test]
fn where_a_submission_ends_changes_no_bit() {
    if gpu().is_none() {
        return;
    }
    let expected = lines("32", false);
    for (tasks, poisoned) in [("1", true), ("5", false)] {
        for (found, expected) in lines(tasks, poisoned).iter().zip(&expected) {
            assert_eq!(found, expected, "submissions of {tasks} launches, poisoned: {poisoned}");
        }
    }
    for ((name, config), line) in runs().iter().zip(&expected) {
        let (on_cpu, _) = train(config, &Device::flex());
        let losses = line.rsplit_once('[').expect("losses").1.trim_end_matches(']');
        let on_gpu: Vec<f32> = losses.split(", ").map(|loss| loss.parse().expect("a number")).collect();
        let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
        let (found, of_cpu) = (mean(&on_gpu), mean(&on_cpu));
        println!("{name}: mean loss {found} on the GPU, {of_cpu} on the CPU");
        assert!((found - of_cpu).abs() <= 1e-2 * of_cpu, "{name}: {found} on the GPU, {of_cpu} on the CPU");
    }
}
