//! Devices by name: what the command line takes, what the machine has, and which of it is meant.

mod choice;
mod name;

#[cfg(feature = "cube")]
mod gpu;

#[cfg(not(feature = "cube"))]
mod gpu {
    //! Nothing to find in a program for the CPU alone.

    use anyhow::{Result, bail};

    use super::{Facts, Found, Runtime};

    pub fn list(_: &[Runtime]) -> Vec<Found> {
        Vec::new()
    }

    pub fn open(found: &Found) -> Result<Facts> {
        bail!("`{}` is in another program than this, which is for the CPU alone", found.adapter.name())
    }
}

use std::fmt::{self, Display};

use anyhow::Result;
use burn::tensor::Device;

pub use choice::{Adapter, Kind, choose};
pub use gpu::{list, open};
pub use name::{DeviceName, Runtime, help};

use crate::progress;

/// An adapter and Burn's handle of it, which opens it at the first use.
#[derive(Clone, Debug)]
pub struct Found {
    /// What is known without opening it.
    pub adapter: Adapter,
    /// For tensors.
    pub device: Device,
}

/// What an adapter says of itself once it is open. Printed on one line: what it is and how it is driven.
#[derive(Clone, Debug)]
pub struct Facts {
    /// The part's name.
    pub name: String,
    /// What it is.
    pub kind: Kind,
    /// The graphics interface and the language of the kernels, or the maker's runtime.
    pub runtime: String,
    /// The largest buffer, bytes.
    pub buffer_limit: u64,
    /// Whether f32 can be added atomically.
    pub float_atomics: bool,
    /// Whether the units of a plane (subgroup, warp) can compute together.
    pub planes: bool,
}

impl Display for Facts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {}, {}", self.name, self.kind, self.runtime)
    }
}

impl DeviceName {
    /// The device, and what `metrics.json` calls it; standard error says what is computed on.
    ///
    /// # Errors
    /// If an adapter is asked for that is not there, or its driver refuses.
    pub fn resolve(self) -> Result<(Device, String)> {
        let (found, adapters) = self.find()?;
        let Some(found) = found else {
            let (device, backend) = self.cpu();
            let why = if self == Self::Auto { format!(": {}", why_cpu(&adapters)) } else { String::new() };
            progress::note(&format!("computing on the CPU, {backend}{why}"));
            return Ok((device, backend.into()));
        };
        let name = open(&found)?.to_string();
        progress::note(&format!("computing on {name}"));
        Ok((found.device, name))
    }

    /// The adapter that a name stands for on this machine, `None` for the CPU; and all that were considered.
    ///
    /// # Errors
    /// If an adapter is asked for that is not there.
    pub fn find(self) -> Result<(Option<Found>, Vec<Adapter>)> {
        let found = list(&self.runtimes());
        let adapters: Vec<Adapter> = found.iter().map(|found| found.adapter).collect();
        let chosen = choose(self, &adapters)?;
        Ok((found.into_iter().find(|found| Some(found.adapter) == chosen), adapters))
    }

    /// Those that have to be asked for adapters. A GPU's driver takes a while to start, so none without need.
    fn runtimes(self) -> Vec<Runtime> {
        match self {
            Self::Cpu | Self::Flex | Self::Ndarray => Vec::new(),
            Self::Auto | Self::Gpu => Runtime::built(),
            Self::Adapter(runtime, _) => vec![runtime],
        }
    }

    /// The CPU backend that a name stands for where it stands for no adapter.
    fn cpu(self) -> (Device, &'static str) {
        if self == Self::Ndarray { (ndarray(), "ndarray") } else { (Device::flex(), "flex") }
    }
}

/// Why `auto` takes none of these.
pub fn why_cpu(adapters: &[Adapter]) -> String {
    match adapters.iter().min_by_key(|adapter| adapter.kind) {
        _ if Runtime::built().is_empty() => "this program is built for the CPU alone".into(),
        None => "no GPU found".into(),
        Some(best) => format!("no GPU found but `{}` ({}), which `--device gpu` takes", best.name(), best.kind),
    }
}

#[allow(deprecated, reason = "Burn still releases it, and this project supports it for comparison with flex")]
fn ndarray() -> Device {
    Device::ndarray()
}
