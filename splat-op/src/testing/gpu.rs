//! The device that the tests of the kernels run on. The crate `splat-tests` follows the same rules.

use std::io::Write;
use std::sync::OnceLock;

#[cfg(feature = "wgpu")]
use burn::backend::WgpuDeviceKind;
use burn::backend::{CubeDevice, DispatchDevice};
use burn::tensor::{Device, DeviceType};

use crate::gpu::{Gpu, poison};

/// The best GPU, a software driver if there is nothing better, and its lesser forms: without plane operations, without float
/// atomics. Empty if there is none or `SPLAT_GPU=skip`, which is said; with `SPLAT_GPU=require` that is a failure.
pub fn gpus() -> Vec<(&'static str, Gpu)> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let Some(gpu) = GPU.get_or_init(find).clone() else { return Vec::new() };
    let mut gpus = vec![("as it is", gpu.clone())];
    if gpu.planes {
        gpus.push(("without planes", Gpu { planes: false, ..gpu.clone() }));
    }
    if gpu.float_atomics {
        gpus.push(("without float atomics", Gpu { float_atomics: false, ..gpu }));
    }
    gpus
}

/// As [`gpus`], only as it is.
pub fn gpu() -> Option<Gpu> {
    gpus().into_iter().next().map(|(_, gpu)| gpu)
}

fn find() -> Option<Gpu> {
    let wish = std::env::var("SPLAT_GPU").unwrap_or_default();
    match wish.as_str() {
        "skip" => {
            say("SKIPPED: the kernels' tests: SPLAT_GPU=skip");
            return None;
        }
        "" | "require" => {}
        other => panic!("SPLAT_GPU={other} means nothing: set it to `require` or `skip`, or not at all"),
    }
    poison(true);
    let Some(device) = best() else {
        assert!(wish != "require", "SPLAT_GPU=require, but there is no adapter");
        say("SKIPPED: the kernels' tests: no adapter; install a driver, or `mesa-vulkan-drivers` for one in software");
        return None;
    };
    let client = device.client();
    say(&format!("the kernels' tests run on {} through {}", client.properties().identity.name, client.name()));
    Some(Gpu::new(&client))
}

/// Past the test harness, which swallows what passing tests print.
fn say(line: &str) {
    // A test must not fail because nobody reads its log.
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// The adapter that is most of a graphics card, of the runtimes built in.
fn best() -> Option<CubeDevice> {
    let runtimes = [
        #[cfg(feature = "wgpu")]
        DeviceType::Wgpu,
        #[cfg(feature = "vulkan")]
        DeviceType::Vulkan,
        #[cfg(feature = "metal")]
        DeviceType::Metal,
        #[cfg(feature = "cuda")]
        DeviceType::Cuda,
        #[cfg(feature = "rocm")]
        DeviceType::Rocm,
    ];
    let devices = runtimes.into_iter().flat_map(|runtime| Device::enumerate(runtime).into_vec());
    let adapters = devices.filter_map(|device| match device.as_dispatch() {
        DispatchDevice::Cube(device) => Some(device.clone()),
        _ => None,
    });
    adapters.min_by_key(rank)
}

/// Graphics cards first, a driver in software last.
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
        // Makers' runtimes list nothing but cards.
        _ => 0,
    }
}
