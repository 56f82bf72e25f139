//! `--device`: devices by name, the adapters of the machine, and the choice among them.

#[cfg(feature = "cube")]
mod gpu;
#[cfg(not(feature = "cube"))]
mod gpu {
    pub const BUILT: &[(&str, ())] = &[];
    pub fn list(_: &dyn Fn(&str) -> bool) -> Vec<super::Adapter> {
        Vec::new()
    }
    pub fn open(_: &super::Adapter) -> anyhow::Result<String> {
        anyhow::bail!("this program is built for the CPU only")
    }
}

use std::fmt::{self, Display};
use std::str::FromStr;

use anyhow::{Result, bail};
use burn::tensor::Device;

pub use self::gpu::{list, open};
use crate::progress;

/// The runtimes that drive GPUs, by their cargo features. Where several reach the same card, the first is preferred.
pub const RUNTIMES: [&str; 5] = ["cuda", "rocm", "metal", "vulkan", "wgpu"];

/// Device to compute on, as named on the command line. `auto`: a GPU if there is one, otherwise the CPU; a driver in software does not count,
/// because the CPU is faster without it. `cpu` or `flex`: Burn's CPU backend. `ndarray`: its older one. `gpu`: the best adapter of any
/// runtime. A runtime: its best adapter, or with a number the one of `splat devices`; those of wgpu are `gpu:0` and so on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceName(String);

impl Default for DeviceName {
    fn default() -> Self {
        Self("auto".into())
    }
}

impl Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, index) = text.split_once(':').unwrap_or((text, "0"));
        let runtime = if name == "gpu" { "wgpu" } else { name };
        let is_built = || text == "gpu" && built().next().is_some() || built().any(|built| built == runtime);
        match RUNTIMES.contains(&runtime) && index.parse::<usize>().is_ok() {
            true if is_built() => Ok(Self(text.into())),
            true => Err(format!("this program was built without `{runtime}`: build it with `--features {runtime}`")),
            false if text == "cpu" => Ok(Self("flex".into())),
            false if ["auto", "flex", "ndarray"].contains(&text) => Ok(Self(text.into())),
            false => Err("pass one of auto, cpu, flex, ndarray, gpu, gpu:0 and what else `splat devices` lists".into()),
        }
    }
}

/// The runtimes that the program was built with.
pub fn built() -> impl Iterator<Item = &'static str> {
    gpu::BUILT.iter().map(|(runtime, _)| *runtime)
}

/// An adapter, one line of `splat devices`. A card that two runtimes reach is two adapters.
#[derive(Clone, Debug)]
pub struct Adapter {
    pub runtime: &'static str,
    pub index: usize,
    pub kind: AdapterKind,
    /// Burn's handle, which opens it at the first use.
    pub device: Device,
}

/// Kind of an adapter, best first. `Unknown`: its driver does not report one. `Software`: its driver renders on the CPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    Discrete,
    Integrated,
    Virtual,
    Unknown,
    Software,
}

impl Adapter {
    /// The value of `--device` that selects this adapter.
    pub fn name(&self) -> String {
        format!("{}:{}", if self.runtime == "wgpu" { "gpu" } else { self.runtime }, self.index)
    }
}

impl DeviceName {
    /// Returns the device and its name in `metrics.json`, and prints the name to standard error. An error if the adapter asked for does not
    /// exist, or its driver refuses.
    pub fn resolve(&self) -> Result<(Device, String)> {
        let open = |adapter: &Adapter| Ok((adapter.device.clone(), open(adapter)?));
        if let Some((device, name)) = self.choose_and_open(&self.list(), open, progress::note)? {
            progress::note(&format!("computing on {name}"));
            return Ok((device, name));
        }
        #[allow(deprecated, reason = "Burn still releases it, and this project supports it for comparison with flex")]
        let device = if self.0 == "ndarray" { Device::ndarray() } else { Device::flex() };
        let (backend, why) = if self.0 == "auto" { ("flex", ": no usable GPU") } else { (&*self.0, "") };
        progress::note(&format!("computing on the CPU, {backend}{why}"));
        Ok((device, backend.into()))
    }

    /// Returns the adapter that the name selects on this machine, `None` for the CPU. An error if the adapter asked for does not exist.
    pub fn find(&self) -> Result<Option<Adapter>> {
        Ok(self.admitted(&self.list())?.first().copied().cloned())
    }

    /// Lists the adapters of the runtimes that the name may mean. A GPU's driver takes a while to start, so none is asked without need.
    fn list(&self) -> Vec<Adapter> {
        list(&|runtime| match self.0.as_str() {
            "auto" | "gpu" => true,
            name => name.starts_with(runtime) || runtime == "wgpu" && name.starts_with("gpu:"),
        })
    }

    /// Returns those of some adapters that the name admits, best first; none where it means the CPU. An error if a GPU is asked for and none is
    /// admitted.
    pub fn admitted<'a>(&self, adapters: &'a [Adapter]) -> Result<Vec<&'a Adapter>> {
        let is_admitted = |adapter: &&Adapter| match self.0.as_str() {
            "auto" => adapter.kind <= AdapterKind::Virtual,
            name => name == "gpu" || name == adapter.runtime || name == adapter.name(),
        };
        let mut found: Vec<&Adapter> = adapters.iter().filter(is_admitted).collect();
        let preference = |of: &Adapter| RUNTIMES.iter().position(|runtime| *runtime == of.runtime);
        found.sort_by_key(|adapter| (adapter.kind, preference(adapter), adapter.index));
        if found.is_empty() && !["auto", "flex", "ndarray"].contains(&self.0.as_str()) {
            let there: Vec<String> = adapters.iter().map(Adapter::name).collect();
            bail!(
                "`--device {self}` finds no adapter: looked for it among [{}]. Install the driver of the card (AMD's ROCm for `rocm`; \
                 Debian and Ubuntu: `libvulkan1` with `mesa-vulkan-drivers`, or NVIDIA's driver), or pass `--device cpu`",
                there.join(", ")
            );
        }
        Ok(found)
    }

    /// Opens the best adapter that the name admits; `None` for the CPU. Where `auto` meets one that does not open, the next best is tried,
    /// then the CPU, and `say` receives a line about each.
    fn choose_and_open<T>(
        &self,
        adapters: &[Adapter],
        open: impl Fn(&Adapter) -> Result<T>,
        mut say: impl FnMut(&str),
    ) -> Result<Option<T>> {
        for adapter in self.admitted(adapters)? {
            match open(adapter) {
                Err(error) if self.0 == "auto" => {
                    say(&format!("going on without `{}`: {}", adapter.name(), format!("{error:#}").replace('\n', " ")));
                }
                opened => return opened.map(Some),
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests;
