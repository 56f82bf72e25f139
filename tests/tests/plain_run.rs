//! Runs in tensor code (`TrainConfig::plain`), and runs as on processors without AVX2, beside runs of operations.

use std::sync::{Mutex, PoisonError};

use burn::tensor::Device;
use glam::{DAffine3, DVec3};
use splat_model::capture::{Capture, Photo, PointCloud, Split, load_all};
use splat_model::density::AdaptiveConfig;
use splat_model::effects::background::{Backdrop, Background};
use splat_model::effects::grid::GridConfig;
use splat_model::effects::optics::OpticsConfig;
use splat_model::effects::pose::PoseConfig;
use splat_model::evaluate::evaluate;
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Intrinsics, test_hooks};
use splat_tests::data::{announce, optional_data};
use splat_tests::scene::host;
use splat_tests::{devices, gpu};

const STEPS: usize = 20;

/// Step of the first refinement, after which the rounding of a gradient can decide about a Gaussian.
const REFINED: usize = 10;

/// Three photographs of noise, from cameras side by side.
fn photos() -> Vec<Photo> {
    let (width, height) = (40, 33);
    let byte = |i: usize| (i % 256) as u8;
    let photo = |view: usize| Photo {
        name: format!("{view}"),
        intrinsics: Intrinsics::centred(width, height, 45.0),
        cam_from_world: DAffine3::from_translation(DVec3::new(0.1 * view as f64, 0.0, 3.0)),
        rgb: (0..width * height).flat_map(|i| [byte(2 * i), byte(90 * view + i / 9), byte(i / 7)]).collect(),
        alpha: None,
        mask: None,
    };
    (0..3).map(photo).collect()
}

/// Points in front of the cameras.
fn points() -> PointCloud {
    let position = |i: usize| [(i % 8) as f32 / 4.0 - 0.9, (i / 8) as f32 / 4.0 - 0.7, (i % 3) as f32 / 4.0];
    PointCloud { positions: (0..48).map(position).collect(), colours: vec![[90, 140, 60]; 48] }
}

/// All effects with an operation of their own, together, and refinements.
fn config(plain: bool) -> TrainConfig {
    TrainConfig {
        steps: STEPS,
        plain,
        sh_every: 5,
        poses: Some(PoseConfig::default()),
        optics: OpticsConfig { motion: true, rolling: true },
        backdrop: Backdrop::Environment { degree: 2 },
        grid: Some(GridConfig::default()),
        density: AdaptiveConfig { every: REFINED, from: REFINED, until_share: 1.0, ..AdaptiveConfig::gradual() }.into(),
        ..TrainConfig::default()
    }
}

/// Counters are global, so that runs go one after the other.
static ALONE: Mutex<()> = Mutex::new(());

/// The losses of a run, what a CPU computed by operations in a step, and the names of kernels in its steps.
fn run(plain: bool, device: &Device) -> (Vec<f64>, u64, Vec<&'static str>) {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut run = Trainer::new(photos(), &points(), config(plain), device).expect("photographs and steps");
    let (mut losses, before) = (Vec::new(), test_hooks::twin_calls());
    let launches = test_hooks::launches(|| {
        losses = (0..STEPS).map(|_| host(run.step().expect("a sound run").loss)[0]).collect();
    });
    (losses, test_hooks::twin_calls() - before, launches.into_keys().collect())
}

#[test]
fn twenty_steps_in_tensor_code_are_those_of_operations() {
    // `project`, `evaluate_sh`, `intersect` and `rasterize`, and all but `intersect` backwards.
    let rasterizer = 7 * STEPS as u64;
    for (name, device) in devices() {
        let (expected, of_operations, kernels) = run(false, &device);
        let (found, of_tensors, plain_kernels) = run(true, &device);
        for (step, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let tolerance = if step < REFINED { 2e-3 } else { 1e-2 };
            assert!(
                (found - expected).abs() <= tolerance * expected,
                "{name}, step {step}: {found} instead of {expected}"
            );
        }
        assert!(expected[STEPS - 1] < expected[0], "{name}: this is not training: {expected:?}");
        if kernels.is_empty() {
            assert!(of_operations > rasterizer, "{name}: {of_operations} calls");
            assert_eq!(of_tensors, rasterizer, "{name}: calls of operations on a CPU");
        }
        let beside = |names: &[&'static str]| -> Vec<&'static str> {
            let of_ours = ["splat_op::effects", "splat_op::training"];
            names.iter().copied().filter(|name| of_ours.iter().any(|of| name.contains(of))).collect()
        };
        assert!(beside(&plain_kernels).is_empty(), "{name}: {:?}", beside(&plain_kernels));
        assert!(kernels.is_empty() || beside(&kernels).len() > 4, "{name}: {kernels:?}");
    }
}

#[test]
fn a_processor_without_avx2_trains_alike() {
    let device = Device::flex();
    let expected = run(false, &device).0;
    test_hooks::force_f32_in_f64(true);
    let found = run(false, &device).0;
    test_hooks::force_f32_in_f64(false);
    assert_ne!(found, expected, "both are computed in f32");
    for (step, (found, expected)) in found.iter().zip(&expected).enumerate() {
        let tolerance = if step < REFINED { 1e-4 } else { 1e-2 };
        assert!((found - expected).abs() <= tolerance * expected, "step {step}: {found} instead of {expected}");
    }
}

/// Mean PSNR of held-out views after 500 steps on `fox_small`, over some seeds: rounding moves single Gaussians across the thresholds of
/// density control.
fn psnr(capture: &Capture, plain: bool, (side, seeds): (Option<u32>, u64), device: &Device) -> f64 {
    let split = Split::every(&capture.views, 8);
    let photos = |views: &[usize]| -> Vec<Photo> {
        load_all(views.iter().map(|view| &capture.views[*view]), side, |_| ()).expect("readable photographs")
    };
    let of_seed = |seed: u64| {
        let config = TrainConfig { plain, seed, ..TrainConfig::for_steps(500) };
        let mut trainer = Trainer::new(photos(&split.train), &capture.points, config, device).expect("a valid run");
        while !trainer.is_done() {
            trainer.step().expect("a valid scene");
        }
        let (options, splats) = (trainer.render_options(), trainer.gaussians().untracked().splats());
        let black = Background::Colour([0.0; 3]);
        let psnr = evaluate(&splats, &photos(&split.test), &black, &options, |_, _| ()).expect("a valid scene").psnr;
        announce(&format!("plain: {plain}, seed {seed}: {psnr:.3} dB"));
        psnr
    };
    (0..seeds).map(of_seed).sum::<f64>() / seeds as f64
}

fn assert_equal_quality(device: &Device, side: Option<u32>, seeds: u64) {
    let Some(folder) = optional_data("fox_small") else { return };
    let capture = Capture::load(&folder).expect("a readable capture");
    let [operations, tensors] = [false, true].map(|plain| psnr(&capture, plain, (side, seeds), device));
    announce(&format!("{operations:.3} dB by operations, {tensors:.3} dB in tensor code"));
    assert!((operations - tensors).abs() <= 0.1, "{operations} dB by operations, {tensors} in tensor code");
}

#[test]
#[ignore = "500 steps, several times and in tensor code: ten minutes on two CPU cores"]
fn a_run_in_tensor_code_reaches_the_quality_of_operations_on_a_cpu() {
    assert_equal_quality(&Device::flex(), None, 3);
}

#[test]
#[ignore = "500 steps in tensor code: half an hour with a GPU in software"]
fn a_run_in_tensor_code_reaches_the_quality_of_operations_on_a_gpu() {
    let Some(device) = gpu() else { return };
    // Poisoned buffers are for tests of the kernels.
    test_hooks::poison(false);
    assert_equal_quality(&device, Some(48), 3);
}
