//! The device of the kernels' tests. The crate `splat-tests` follows the same rules.

use std::io::Write;
use std::sync::OnceLock;

#[cfg(feature = "wgpu")]
use burn::backend::WgpuDeviceKind;
use burn::backend::{CubeDevice, DispatchDevice};
use burn::tensor::{Device, DeviceType};

use crate::gpu::{Gpu, poison};

/// The best GPU (a software driver if there is no other) as it is, without float atomics, and without planes. If there is no GPU or
/// `SPLAT_GPU=skip` is set, the result is empty and a line says so. With `SPLAT_GPU=require` a missing GPU is a failure.
/// `SPLAT_RUNTIME` names the only runtime that is asked, by its feature.
pub fn gpus() -> Vec<(&'static str, Gpu)> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let Some(gpu) = GPU.get_or_init(find).clone() else { return Vec::new() };
    let mut gpus = vec![("as it is", gpu.clone())];
    if gpu.float_atomics {
        gpus.push(("without float atomics", Gpu { float_atomics: false, ..gpu.clone() }));
    }
    if gpu.plane_units.is_some() {
        gpus.push(("without planes", Gpu { plane_units: None, ..gpu }));
    }
    gpus
}

/// The first of [`gpus`], with all its features.
pub fn gpu() -> Option<Gpu> {
    gpus().into_iter().next().map(|(_, gpu)| gpu)
}

/// The device of [`gpu`], for tests of tensor functions.
pub fn device() -> Option<Device> {
    gpu().and_then(|_| best()).map(|device| Device::new(DispatchDevice::Cube(device)))
}

fn find() -> Option<Gpu> {
    let wish = std::env::var("SPLAT_GPU").unwrap_or_default();
    match wish.as_str() {
        "skip" => {
            say("SKIPPED: the kernels' tests: SPLAT_GPU=skip");
            return None;
        }
        "" | "require" => {}
        other => panic!("SPLAT_GPU={other} is not supported: set it to `require` or `skip`, or leave it unset"),
    }
    poison(true);
    let Some(device) = best() else {
        assert!(wish != "require", "SPLAT_GPU=require, but there is no adapter");
        say("SKIPPED: the kernels' tests: no adapter; install a driver, or `mesa-vulkan-drivers` for one in software");
        return None;
    };
    let client = device.client();
    let gpu = Gpu::new(&client);
    say(&format!(
        "the kernels' tests run on {} through {}, {} float atomics, {}",
        client.properties().identity.name,
        client.name(),
        if gpu.float_atomics { "with" } else { "without" },
        gpu.plane_units.map_or("without planes".into(), |units| format!("planes of {units}"))
    ));
    Some(gpu)
}

/// Writes to stderr directly, because the test harness captures the output of passing tests.
fn say(line: &str) {
    // A closed stderr must not fail a test.
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// The best adapter of the runtimes that are compiled in, graphics cards first.
fn best() -> Option<CubeDevice> {
    let runtimes = [
        #[cfg(feature = "wgpu")]
        ("wgpu", DeviceType::Wgpu),
        #[cfg(feature = "vulkan")]
        ("vulkan", DeviceType::Vulkan),
        #[cfg(feature = "metal")]
        ("metal", DeviceType::Metal),
        #[cfg(feature = "cuda")]
        ("cuda", DeviceType::Cuda),
        #[cfg(feature = "rocm")]
        ("rocm", DeviceType::Rocm),
    ];
    let only = std::env::var("SPLAT_RUNTIME").ok();
    let asked = runtimes.into_iter().filter(|(feature, _)| only.as_deref().is_none_or(|only| only == *feature));
    let devices = asked.flat_map(|(_, runtime)| Device::enumerate(runtime).into_vec());
    let adapters = devices.filter_map(|device| match device.as_dispatch() {
        DispatchDevice::Cube(device) => Some(device.clone()),
        _ => None,
    });
    adapters.min_by_key(rank)
}

/// Sort key of adapters: graphics cards first, software drivers last.
fn rank(device: &CubeDevice) -> u8 {
    match device {
        #[cfg(feature = "wgpu")]
        CubeDevice::Wgpu(device) => match device.kind {
            WgpuDeviceKind::DiscreteGpu(_) => 0,
            WgpuDeviceKind::IntegratedGpu(_) => 1,
            WgpuDeviceKind::VirtualGpu(_) => 2,
            WgpuDeviceKind::Cpu => 4,
            _ => 3,
        },
        // CUDA's and ROCm's runtimes list graphics cards only.
        _ => 0,
    }
}
