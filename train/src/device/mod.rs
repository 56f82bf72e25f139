//! `--device`: devices by name, the adapters of the machine, and the choice among them.

#[cfg(feature = "cube")]
mod gpu;
#[cfg(not(feature = "cube"))]
mod gpu {
    use super::{Adapter, Facts, Runtime};

    pub fn list(_: &[Runtime]) -> Vec<Adapter> {
        Vec::new()
    }

    pub fn open(adapter: &Adapter) -> anyhow::Result<Facts> {
        anyhow::bail!("`{}` is not supported: this program is built for the CPU only", adapter.name())
    }
}

use std::fmt::{self, Display};
use std::str::FromStr;

use anyhow::{Result, bail};
use burn::tensor::Device;

pub use self::gpu::{list, open};
use crate::progress;

/// Device to compute on, as named on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceName {
    /// A GPU if there is one, otherwise the CPU. A driver in software does not count: the CPU is faster without it.
    #[default]
    Auto,
    /// Burn's CPU backend, also named `cpu`.
    Flex,
    /// Burn's older CPU backend, deprecated by Burn.
    Ndarray,
    /// The best adapter of any runtime; a driver in software only if there is no other.
    Gpu,
    /// An adapter of one runtime, by its index in `splat devices`; without an index, the best of them.
    Adapter(Runtime, Option<usize>),
}

/// Runtime that drives a GPU. Ordered by preference where several reach the same card: a runtime for one maker's cards is built in
/// only on request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Runtime {
    /// NVIDIA's CUDA.
    Cuda,
    /// AMD's ROCm.
    Rocm,
    /// Metal through wgpu, with kernels in Metal's language.
    Metal,
    /// Vulkan through wgpu, with kernels in SPIR-V.
    Vulkan,
    /// Any graphics interface that the system offers, through wgpu.
    Wgpu,
}

impl Runtime {
    /// All runtimes, whether this build has them or not.
    pub const ALL: [Self; 5] = [Self::Wgpu, Self::Vulkan, Self::Metal, Self::Cuda, Self::Rocm];

    /// The cargo feature that builds it in.
    pub fn feature(self) -> &'static str {
        match self {
            Self::Wgpu => "wgpu",
            Self::Vulkan => "vulkan",
            Self::Metal => "metal",
            Self::Cuda => "cuda",
            Self::Rocm => "rocm",
        }
    }

    /// The runtimes that the program was built with.
    pub fn built() -> Vec<Self> {
        let is_built = |runtime: &Self| match runtime {
            Self::Wgpu => cfg!(feature = "wgpu"),
            Self::Vulkan => cfg!(feature = "vulkan"),
            Self::Metal => cfg!(feature = "metal"),
            Self::Cuda => cfg!(feature = "cuda"),
            Self::Rocm => cfg!(feature = "rocm"),
        };
        Self::ALL.into_iter().filter(is_built).collect()
    }

    /// Prefix of its adapters on the command line, before the index.
    pub fn prefix(self) -> &'static str {
        if self == Self::Wgpu { "gpu" } else { self.feature() }
    }
}

impl Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Flex => f.write_str("flex"),
            Self::Ndarray => f.write_str("ndarray"),
            Self::Gpu => f.write_str("gpu"),
            Self::Adapter(runtime, None) => f.write_str(runtime.prefix()),
            Self::Adapter(runtime, Some(index)) => write!(f, "{}:{index}", runtime.prefix()),
        }
    }
}

impl FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, index) = text.split_once(':').map_or((text, None), |(name, index)| (name, Some(index)));
        match (name, index) {
            ("auto", None) => return Ok(Self::Auto),
            ("cpu" | "flex", None) => return Ok(Self::Flex),
            ("ndarray", None) => return Ok(Self::Ndarray),
            ("gpu", None) if !Runtime::built().is_empty() => return Ok(Self::Gpu),
            ("auto" | "cpu" | "flex" | "ndarray", Some(_)) => {
                return Err(format!("only adapters have numbers: pass `{name}`"));
            }
            _ => {}
        }
        let runtime = Runtime::ALL.into_iter().find(|runtime| runtime.prefix() == name);
        let runtime = runtime.ok_or_else(|| format!("there is no such device: pass one of {}", names()))?;
        if !Runtime::built().contains(&runtime) {
            let (feature, other) = (runtime.feature(), names());
            return Err(format!(
                "this program was built without `{feature}`: build it with `--features {feature}`, or pass one of {other}"
            ));
        }
        let number = |index: &str| index.parse().map_err(|_| format!("{index:?} is not a number, as in `{name}:0`"));
        Ok(Self::Adapter(runtime, index.map(number).transpose()?))
    }
}

/// Returns the help text of `--device`.
pub fn help() -> String {
    format!("Device to compute on, one of {}; `splat devices` lists them", names())
}

/// The values that this build accepts.
fn names() -> String {
    let built = Runtime::built();
    let best = (!built.is_empty() && !built.contains(&Runtime::Wgpu)).then(|| "gpu".to_owned());
    let adapters = built.iter().map(|runtime| format!("{}[:N]", runtime.prefix()));
    let names = ["auto", "cpu", "flex", "ndarray"].map(String::from).into_iter().chain(best).chain(adapters);
    names.collect::<Vec<_>>().join(", ")
}

/// Kind of an adapter, best first. `Unknown`: its driver does not report one. `Software`: its driver renders on the CPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs, reason = "the words of the drivers")]
pub enum AdapterKind {
    Discrete,
    Integrated,
    Virtual,
    Unknown,
    Software,
}

impl Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", format!("{self:?}").to_lowercase())
    }
}

/// An adapter, one line of `splat devices`. A card that two runtimes reach is two adapters.
#[derive(Clone, Debug)]
pub struct Adapter {
    /// Runtime that reaches it.
    pub runtime: Runtime,
    /// Index among the adapters of its runtime.
    pub index: usize,
    /// Kind of the adapter.
    pub kind: AdapterKind,
    /// Burn's handle, which opens it at the first use.
    pub device: Device,
}

impl Adapter {
    /// The value of `--device` that selects this adapter.
    pub fn name(&self) -> DeviceName {
        DeviceName::Adapter(self.runtime, Some(self.index))
    }
}

/// Properties of an open adapter.
#[derive(Clone, Debug)]
pub struct Facts {
    /// Name and kind of the hardware; graphics interface and language of the kernels, or the maker's runtime.
    pub summary: String,
    /// Largest buffer, bytes.
    pub buffer_limit: u64,
    /// Whether atomic additions of f32 are supported.
    pub float_atomics: bool,
}

/// Returns the adapter that a name selects; `None` for the CPU.
///
/// # Errors
/// If a GPU is asked for and no adapter matches; the message names the drivers that were looked for and the remedy.
pub fn choose(name: DeviceName, adapters: &[Adapter]) -> Result<Option<&Adapter>> {
    let best = |admitted: &dyn Fn(&Adapter) -> bool| {
        let admitted = adapters.iter().filter(|adapter| admitted(adapter));
        admitted.min_by_key(|adapter| (adapter.kind, adapter.runtime, adapter.index))
    };
    let (found, runtimes) = match name {
        DeviceName::Flex | DeviceName::Ndarray => return Ok(None),
        DeviceName::Auto => return Ok(best(&|adapter| adapter.kind <= AdapterKind::Virtual)),
        DeviceName::Gpu => (best(&|_| true), Runtime::built()),
        DeviceName::Adapter(runtime, index) => (
            best(&|adapter| adapter.runtime == runtime && index.is_none_or(|index| adapter.index == index)),
            vec![runtime],
        ),
    };
    let count = adapters.iter().filter(|adapter| runtimes.contains(&adapter.runtime)).count();
    let needed = match runtimes.first() {
        _ if found.is_some() => return Ok(found),
        None => {
            bail!("this program is built for the CPU only: build it with its default features, or pass `--device cpu`")
        }
        Some(_) if count > 0 => bail!(
            "there is no adapter `{name}`: the last has the number {}; `splat devices` lists all devices",
            count - 1
        ),
        Some(Runtime::Cuda) => "NVIDIA's driver",
        Some(Runtime::Rocm) => "AMD's ROCm",
        Some(Runtime::Metal) => "macOS, the only system with Metal",
        Some(_) if !cfg!(target_os = "linux") => "the GPU's driver",
        Some(_) => "the GPU's driver (Debian and Ubuntu: `libvulkan1` with `mesa-vulkan-drivers`, or NVIDIA's driver)",
    };
    let looked: Vec<&str> = runtimes.iter().map(|runtime| runtime.feature()).collect();
    bail!(
        "`--device {name}` finds no adapter: looked for those of {}. Install {needed}; or pass `--device cpu`",
        looked.join(", ")
    )
}

/// Opens the adapter that a name selects; `None` for the CPU. Where `auto` selects one that does not open, the next best is tried, then the
/// CPU, and `say` receives a line about each.
fn choose_and_open<T>(
    name: DeviceName,
    mut adapters: Vec<Adapter>,
    mut open: impl FnMut(&Adapter) -> Result<T>,
    mut say: impl FnMut(&str),
) -> Result<Option<T>> {
    while let Some(adapter) = choose(name, &adapters)? {
        match open(adapter) {
            Err(error) if name == DeviceName::Auto => {
                let (why, refused) = (format!("{error:#}").replace('\n', " "), adapter.name());
                adapters.retain(|other| other.name() != refused);
                let next = choose(name, &adapters)?.map_or("the CPU".into(), |next| format!("`{}`", next.name()));
                say(&format!("going on with {next}: {why}"));
            }
            opened => return opened.map(Some),
        }
    }
    Ok(None)
}

impl DeviceName {
    /// Returns the device and its name in `metrics.json`, and prints the name to standard error.
    ///
    /// # Errors
    /// If the adapter asked for does not exist, or its driver refuses.
    pub fn resolve(self) -> Result<(Device, String)> {
        let adapters = list(&self.runtimes());
        let mut why = if self == Self::Auto { format!(": {}", why_cpu(&adapters)) } else { String::new() };
        let open = |adapter: &Adapter| Ok((adapter.device.clone(), open(adapter)?.summary));
        let opened = choose_and_open(self, adapters, open, |line| {
            why.clear();
            progress::note(line);
        })?;
        if let Some((device, name)) = opened {
            progress::note(&format!("computing on {name}"));
            return Ok((device, name));
        }
        let (device, backend) = if self == Self::Ndarray { (ndarray(), "ndarray") } else { (Device::flex(), "flex") };
        progress::note(&format!("computing on the CPU, {backend}{why}"));
        Ok((device, backend.into()))
    }

    /// Returns the adapter that a name selects on this machine, `None` for the CPU.
    ///
    /// # Errors
    /// If the adapter asked for does not exist.
    pub fn find(self) -> Result<Option<Adapter>> {
        Ok(choose(self, &list(&self.runtimes()))?.cloned())
    }

    /// The runtimes to query for adapters. A GPU's driver takes a while to start, so none is queried without need.
    fn runtimes(self) -> Vec<Runtime> {
        match self {
            Self::Flex | Self::Ndarray => Vec::new(),
            Self::Auto | Self::Gpu => Runtime::built(),
            Self::Adapter(runtime, _) => vec![runtime],
        }
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

#[cfg(test)]
mod tests;
