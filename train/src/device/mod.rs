//! Devices by name: the names that the command line accepts, the adapters of the machine, and the choice among them.

mod choice;
mod name;

#[cfg(feature = "cube")]
mod gpu;

#[cfg(not(feature = "cube"))]
mod gpu {
    //! Lists no adapters: this program is built for the CPU only.

    use anyhow::{Result, bail};

    use super::{AdapterDevice, Facts, Runtime};

    pub fn list(_: &[Runtime]) -> Vec<AdapterDevice> {
        Vec::new()
    }

    pub fn open(found: &AdapterDevice) -> Result<Facts> {
        bail!("`{}` is not supported: this program is built for the CPU only", found.adapter.name())
    }
}

use std::fmt::{self, Display};

use anyhow::{Context, Result};
use burn::tensor::Device;

pub use choice::{Adapter, AdapterKind, choose, choose_and_open};
pub use gpu::{list, open};
pub use name::{DeviceName, Runtime, help};

use crate::progress;

/// An adapter with Burn's handle, which opens it at the first use.
#[derive(Clone, Debug)]
pub struct AdapterDevice {
    /// Properties known without opening it.
    pub adapter: Adapter,
    /// Burn's device, for tensors.
    pub device: Device,
}

/// Properties of an open adapter. `Display` prints the name, kind and runtime on one line.
#[derive(Clone, Debug)]
pub struct Facts {
    /// Name of the hardware.
    pub name: String,
    /// Kind of the adapter.
    pub kind: AdapterKind,
    /// Graphics interface and language of the kernels, or the maker's runtime.
    pub runtime: String,
    /// Largest buffer, bytes.
    pub buffer_limit: u64,
    /// Whether atomic additions of f32 are supported.
    pub float_atomics: bool,
}

impl Display for Facts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {}, {}", self.name, self.kind, self.runtime)
    }
}

impl DeviceName {
    /// Returns the device and its name in `metrics.json`, and prints the name to standard error.
    ///
    /// # Errors
    /// If the adapter asked for does not exist, or its driver refuses.
    pub fn resolve(self) -> Result<(Device, String)> {
        let found = list(&self.runtimes());
        let adapters: Vec<Adapter> = found.iter().map(|found| found.adapter).collect();
        let device_of = |adapter| found.iter().find(|found| found.adapter == adapter).context("it was listed");
        let (open, mut refused) = (|adapter| Ok((device_of(adapter)?, open(device_of(adapter)?)?)), false);
        let opened = choose_and_open(self, &adapters, open, |line| {
            refused = true;
            progress::note(line);
        })?;
        let Some((found, facts)) = opened else {
            let (device, backend) = self.cpu();
            let said = self == Self::Auto && !refused;
            let why = if said { format!(": {}", why_cpu(&adapters)) } else { String::new() };
            progress::note(&format!("computing on the CPU, {backend}{why}"));
            return Ok((device, backend.into()));
        };
        progress::note(&format!("computing on {facts}"));
        Ok((found.device.clone(), facts.to_string()))
    }

    /// Returns the adapter that a name selects on this machine, `None` for the CPU, and all adapters considered.
    ///
    /// # Errors
    /// If the adapter asked for does not exist.
    pub fn find(self) -> Result<(Option<AdapterDevice>, Vec<Adapter>)> {
        let found = list(&self.runtimes());
        let adapters: Vec<Adapter> = found.iter().map(|found| found.adapter).collect();
        let chosen = choose(self, &adapters)?;
        Ok((found.into_iter().find(|found| Some(found.adapter) == chosen), adapters))
    }

    /// The runtimes to query for adapters. A GPU's driver takes a while to start, so none is queried without need.
    fn runtimes(self) -> Vec<Runtime> {
        match self {
            Self::Cpu | Self::Flex | Self::Ndarray => Vec::new(),
            Self::Auto | Self::Gpu => Runtime::built(),
            Self::Adapter(runtime, _) => vec![runtime],
        }
    }

    /// The CPU backend of a name that selects no adapter.
    fn cpu(self) -> (Device, &'static str) {
        if self == Self::Ndarray { (ndarray(), "ndarray") } else { (Device::flex(), "flex") }
    }
}

/// The reason why `auto` chooses none of these adapters.
pub fn why_cpu(adapters: &[Adapter]) -> String {
    match adapters.iter().min_by_key(|adapter| adapter.kind) {
        _ if Runtime::built().is_empty() => "this program is built for the CPU only".into(),
        None => "no GPU found".into(),
        Some(best) => format!("no GPU found but `{}` ({}), which `--device gpu` takes", best.name(), best.kind),
    }
}

#[allow(deprecated, reason = "Burn still releases it, and this project supports it for comparison with flex")]
fn ndarray() -> Device {
    Device::ndarray()
}
