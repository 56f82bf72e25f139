//! Adapters of this machine.

use anyhow::{Result, anyhow};
use burn::backend::{CubeDevice, DispatchDevice};
use burn::tensor::{Device, DeviceType};
use splat_op::Abilities;

use super::{Adapter, AdapterKind, Facts, Runtime};

/// Lists the adapters of some runtimes, in the order of the runtimes and then by index. Empty without a driver.
pub fn list(runtimes: &[Runtime]) -> Vec<Adapter> {
    #[cfg(feature = "cuda")]
    if runtimes.contains(&Runtime::Cuda) {
        keep_kernels();
    }
    let of = |&runtime| {
        let found = move |(index, device)| Adapter { runtime, index, kind: kind(&device), device };
        enumerate(runtime).into_iter().enumerate().map(found)
    };
    runtimes.iter().flat_map(of).collect()
}

/// Has CubeCL keep compiled kernels in the user's cache folder, or where its configuration file says. Has no effect once a device is open.
#[cfg(feature = "cuda")]
fn keep_kernels() {
    use cubecl::config::{CubeClRuntimeConfig, RuntimeConfig, cache::CacheConfig};

    let mut config = CubeClRuntimeConfig::from_current_dir().override_from_env();
    config.compilation.cache = true;
    // The folder `target` of a project is CubeCL's default.
    if matches!(config.environment.path, CacheConfig::Target) {
        config.environment.path = CacheConfig::Global;
    }
    let _ = CubeClRuntimeConfig::try_set(config);
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
pub fn open(adapter: &Adapter) -> Result<Facts> {
    let name = adapter.name();
    let refused =
        |why: &str| anyhow!("cannot open the adapter `{name}`: {why}. Check its driver, or pass `--device cpu`");
    let DispatchDevice::Cube(device) = adapter.device.as_dispatch() else { return Err(refused("it is no adapter")) };
    let interface = open_through_wgpu(device).map_err(|error| refused(&error))?;
    let client = device.client();
    let abilities = Abilities::of(&adapter.device).ok_or_else(|| refused("there are no kernels for it"))?;
    let interface = interface.map(|interface| format!("{interface}, ")).unwrap_or_default();
    let hardware = &client.properties().identity.name;
    Ok(Facts {
        summary: format!("{hardware}, {}, {interface}{}", adapter.kind, client.name()),
        buffer_limit: client.properties().memory.max_page_size,
        float_atomics: abilities.float_atomics,
    })
}

/// Opens an adapter of wgpu by the call that reports a failure instead of panicking. Returns the name of the graphics
/// interface; `None` for other runtimes and for an adapter that was open already.
#[cfg(feature = "wgpu")]
fn open_through_wgpu(device: &CubeDevice) -> Result<Option<String>, String> {
    use burn::backend::wgpu::graphics::AutoGraphicsApi;
    use burn::backend::wgpu::{RuntimeOptions, WgpuInitError, try_init_setup};

    let CubeDevice::Wgpu(device) = device else { return Ok(None) };
    let options = RuntimeOptions::try_default().map_err(|error| error.to_string())?;
    match try_init_setup::<AutoGraphicsApi>(device, options) {
        Ok(setup) => Ok(Some(setup.backend.to_str().to_owned())),
        Err(WgpuInitError::Registration { .. }) => Ok(None),
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(not(feature = "wgpu"))]
fn open_through_wgpu(_: &CubeDevice) -> Result<Option<String>, String> {
    Ok(None)
}
