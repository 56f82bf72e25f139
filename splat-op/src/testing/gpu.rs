//! The device that the tests of the kernels run on. The crate `splat-tests` follows the same rules.

use std::sync::OnceLock;

use burn::backend::DispatchDevice;
use burn::tensor::{Device, DeviceType};

use crate::gpu::{Gpu, poison};

/// The first GPU, a software driver if there is nothing better, and its lesser forms: without plane operations, without
/// float atomics. Empty if there is none or `SPLAT_GPU=skip`, which is said; with `SPLAT_GPU=require` that is a failure.
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
    if wish == "skip" {
        eprintln!("GPU tests are skipped: SPLAT_GPU=skip");
        return None;
    }
    poison(true);
    let client = Device::enumerate(DeviceType::Wgpu).into_vec().iter().find_map(|device| match device.as_dispatch() {
        DispatchDevice::Cube(device) => Some(device.client()),
        _ => None,
    });
    assert!(client.is_some() || wish != "require", "SPLAT_GPU=require, but there is no adapter");
    if client.is_none() {
        eprintln!(
            "GPU tests are skipped: no adapter found; install a driver, or `mesa-vulkan-drivers` for one in software"
        );
    }
    client.map(|client| Gpu::new(&client))
}
