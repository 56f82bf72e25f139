//! Adapters of this machine.

use anyhow::{Result, anyhow, bail};
use burn::backend::{CubeDevice, DispatchDevice};
use burn::tensor::{Device, DeviceType};
use splat_op::Abilities;

use super::{Adapter, AdapterDevice, AdapterKind, Facts, Runtime};

/// Lists the adapters of some runtimes, in the order of the runtimes and then by index. Empty without a driver.
pub fn list(runtimes: &[Runtime]) -> Vec<AdapterDevice> {
    let of = |&runtime| {
        let found =
            move |(index, device)| AdapterDevice { adapter: Adapter { runtime, index, kind: kind(&device) }, device };
        enumerate(runtime).into_iter().enumerate().map(found)
    };
    runtimes.iter().flat_map(of).collect()
}

fn enumerate(runtime: Runtime) -> Vec<Device> {
    let kind_of_device = match runtime {
        #[cfg(feature = "wgpu")]
        Runtime::Wgpu => DeviceType::Wgpu,
        #[cfg(feature = "vulkan")]
        Runtime::Vulkan => DeviceType::Vulkan,
        #[cfg(feature = "metal")]
        Runtime::Metal => DeviceType::Metal,
        #[cfg(feature = "cuda")]
        Runtime::Cuda => DeviceType::Cuda,
        #[cfg(feature = "rocm")]
        Runtime::Rocm => DeviceType::Rocm,
        #[allow(unreachable_patterns, reason = "a build with every runtime leaves none over")]
        _ => return Vec::new(),
    };
    Device::enumerate(kind_of_device).into_vec()
}

fn kind(device: &Device) -> AdapterKind {
    match device.as_dispatch() {
        #[cfg(feature = "wgpu")]
        DispatchDevice::Cube(CubeDevice::Wgpu(device)) => {
            use burn::backend::WgpuDeviceKind;
            match device.kind {
                WgpuDeviceKind::DiscreteGpu(_) => AdapterKind::Discrete,
                WgpuDeviceKind::IntegratedGpu(_) => AdapterKind::Integrated,
                WgpuDeviceKind::VirtualGpu(_) => AdapterKind::Virtual,
                WgpuDeviceKind::Cpu => AdapterKind::Software,
                _ => AdapterKind::Unknown,
            }
        }
        // The makers' runtimes list only their own cards, almost all of which are discrete.
        DispatchDevice::Cube(CubeDevice::Cuda(_) | CubeDevice::Hip(_)) => AdapterKind::Discrete,
        _ => AdapterKind::Unknown,
    }
}

/// Opens an adapter for the rest of the process and returns its properties.
///
/// # Errors
/// If its driver refuses.
pub fn open(found: &AdapterDevice) -> Result<Facts> {
    let name = found.adapter.name();
    let refused =
        |why: &str| anyhow!("cannot open the adapter `{name}`: {why}. Check its driver, or pass `--device cpu`");
    let DispatchDevice::Cube(device) = found.device.as_dispatch() else {
        bail!("`{name}` is not an adapter");
    };
    let interface = open_through_wgpu(device).map_err(|error| refused(&error))?;
    let client = device.client();
    let abilities = Abilities::of(&found.device).ok_or_else(|| refused("there are no kernels for it"))?;
    let language = language(client.name());
    Ok(Facts {
        name: client.properties().identity.name.clone(),
        kind: found.adapter.kind,
        runtime: interface.map_or(language.to_owned(), |interface| format!("{interface}, {language}")),
        buffer_limit: client.properties().memory.max_page_size,
        float_atomics: abilities.float_atomics,
    })
}

/// Opens an adapter of wgpu by the call that reports a failure instead of panicking. Returns the name of the graphics
/// interface; `None` for other runtimes and for an adapter that was open already.
#[cfg(feature = "wgpu")]
fn open_through_wgpu(device: &CubeDevice) -> Result<Option<&'static str>, String> {
    use burn::backend::wgpu::graphics::AutoGraphicsApi;
    use burn::backend::wgpu::{RuntimeOptions, WgpuInitError, try_init_setup};

    let CubeDevice::Wgpu(device) = device else { return Ok(None) };
    let options = RuntimeOptions::try_default().map_err(|error| error.to_string())?;
    match try_init_setup::<AutoGraphicsApi>(device, options) {
        Ok(setup) => Ok(Some(match setup.backend.to_str() {
            "vulkan" => "Vulkan",
            "metal" => "Metal",
            "dx12" => "DirectX 12",
            "gl" => "OpenGL",
            other => other,
        })),
        Err(WgpuInitError::Registration { .. }) => Ok(None),
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(not(feature = "wgpu"))]
fn open_through_wgpu(_: &CubeDevice) -> Result<Option<&'static str>, String> {
    Ok(None)
}

/// The language that kernels are compiled to, from CubeCL's name of the runtime.
fn language(runtime: &str) -> &str {
    match runtime {
        "wgpu<wgsl>" => "WGSL",
        "wgpu<spirv>" => "SPIR-V",
        "wgpu<msl>" => "MSL",
        "cuda" => "CUDA",
        "hip" => "ROCm",
        other => other,
    }
}
