//! Adapters of this machine.

use anyhow::{Result, anyhow};
use burn::backend::{CubeDevice, DispatchDevice};
use burn::tensor::{Device, DeviceType};

use super::{Adapter, AdapterKind};

/// The runtimes of this build.
pub const BUILT: &[(&str, DeviceType)] = &[
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

/// Lists the adapters of the wanted runtimes, in the order in which they are built in, and then by index. Empty without a driver.
pub fn list(is_wanted: &dyn Fn(&str) -> bool) -> Vec<Adapter> {
    #[cfg(feature = "cuda")]
    {
        use cubecl::config::{CubeClRuntimeConfig, RuntimeConfig, cache::CacheConfig};
        // Compiled kernels are kept in the user's cache folder, or where CubeCL's configuration file says. No effect once a device is open.
        let mut config = CubeClRuntimeConfig::from_current_dir().override_from_env();
        config.compilation.cache = true;
        if matches!(config.environment.path, CacheConfig::Target) {
            config.environment.path = CacheConfig::Global;
        }
        let _ = CubeClRuntimeConfig::try_set(config);
    }
    let of = |&(runtime, ref devices): &(&'static str, DeviceType)| {
        let found = move |(index, device)| Adapter { runtime, index, kind: kind(&device), device };
        Device::enumerate(devices.clone()).into_vec().into_iter().enumerate().map(found)
    };
    BUILT.iter().filter(|(runtime, _)| is_wanted(runtime)).flat_map(of).collect()
}

fn kind(device: &Device) -> AdapterKind {
    #[cfg(feature = "wgpu")]
    use burn::backend::WgpuDeviceKind;
    match device.as_dispatch() {
        #[cfg(feature = "wgpu")]
        DispatchDevice::Cube(CubeDevice::Wgpu(device)) => match device.kind {
            WgpuDeviceKind::DiscreteGpu(_) => AdapterKind::Discrete,
            WgpuDeviceKind::IntegratedGpu(_) => AdapterKind::Integrated,
            WgpuDeviceKind::VirtualGpu(_) => AdapterKind::Virtual,
            WgpuDeviceKind::Cpu => AdapterKind::Software,
            _ => AdapterKind::Unknown,
        },
        // The makers' runtimes list only their own cards, almost all of which are discrete.
        DispatchDevice::Cube(CubeDevice::Cuda(_) | CubeDevice::Hip(_)) => AdapterKind::Discrete,
        _ => AdapterKind::Unknown,
    }
}

/// Opens an adapter for the rest of the process. Returns name and kind of the hardware, the graphics interface, and the language of the kernels
/// or the maker's runtime. An error if its driver refuses.
pub fn open(adapter: &Adapter) -> Result<String> {
    let name = adapter.name();
    let refused = |why: &str| anyhow!("cannot open `{name}`: {why}. Check its driver, or pass `--device cpu`");
    let DispatchDevice::Cube(device) = adapter.device.as_dispatch() else { return Err(refused("it is no adapter")) };
    #[cfg(feature = "cuda")]
    if adapter.runtime == "cuda" {
        check_toolkit().map_err(|missing| anyhow!("cannot open `{name}`: {missing}, or pass `--device cpu`"))?;
    }
    #[cfg_attr(not(feature = "wgpu"), expect(unused_mut, reason = "only wgpu has several interfaces"))]
    let mut interface = String::new();
    #[cfg(feature = "wgpu")]
    if let CubeDevice::Wgpu(device) = device {
        use burn::backend::wgpu::{RuntimeOptions, WgpuInitError, graphics::AutoGraphicsApi, try_init_setup};

        // Other calls panic where the driver refuses.
        let options = RuntimeOptions::try_default().map_err(|error| refused(&error.to_string()))?;
        match try_init_setup::<AutoGraphicsApi>(device, options) {
            Ok(setup) => interface = format!("{}, ", setup.backend.to_str()),
            // It is open already.
            Err(WgpuInitError::Registration { .. }) => {}
            Err(error) => return Err(refused(&error.to_string())),
        }
    }
    let client = device.client();
    let (hardware, kind) = (&client.properties().identity.name, format!("{:?}", adapter.kind).to_lowercase());
    Ok(format!("{hardware}, {kind}, {interface}{}", client.name()))
}

/// Checks for the parts of the CUDA toolkit that compile kernels. CubeCL needs them at the first launch, and panics without them.
#[cfg(feature = "cuda")]
fn check_toolkit() -> Result<(), String> {
    // SAFETY: the library has no requirements on who loads it.
    if !unsafe { cudarc::nvrtc::sys::is_culib_present() } {
        let variable = if cfg!(windows) { "PATH" } else { "LD_LIBRARY_PATH" };
        return Err(format!(
            "its kernels are compiled by NVRTC of the CUDA toolkit, whose library is not found. Install the toolkit, add its folder of \
             libraries to `{variable}`"
        ));
    }
    if cubecl::cuda::install::cuda_path().is_none() {
        return Err(
            "the folder of the CUDA toolkit is not known. Install the toolkit, set `CUDA_PATH` to its folder".into()
        );
    }
    Ok(())
}
