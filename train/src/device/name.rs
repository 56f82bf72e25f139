//! The values of `--device`.

use std::fmt::{self, Display};
use std::str::FromStr;

/// Device to compute on, as named on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceName {
    /// A GPU if there is one, otherwise the CPU. A software adapter does not count: the CPU is faster without it.
    #[default]
    Auto,
    /// The faster of the CPU backends: `flex`.
    Cpu,
    /// Burn's CPU backend.
    Flex,
    /// Burn's older CPU backend, deprecated by Burn.
    Ndarray,
    /// The best adapter of any runtime; a software adapter only if there is no other.
    Gpu,
    /// An adapter of one runtime, by its index in `splat devices`; without an index, the best of them.
    Adapter(Runtime, Option<usize>),
}

/// Runtime that drives a GPU; also the name of a cargo feature.
///
/// Ordered by preference where several reach the same card: a runtime for one maker's cards is built in only on
/// request.
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

    /// The cargo feature that builds it in, and whether the program was built with it.
    fn built_by(self) -> (&'static str, bool) {
        match self {
            Self::Wgpu => ("wgpu", cfg!(feature = "wgpu")),
            Self::Vulkan => ("vulkan", cfg!(feature = "vulkan")),
            Self::Metal => ("metal", cfg!(feature = "metal")),
            Self::Cuda => ("cuda", cfg!(feature = "cuda")),
            Self::Rocm => ("rocm", cfg!(feature = "rocm")),
        }
    }

    /// Whether the program was built with it.
    pub fn is_built(self) -> bool {
        self.built_by().1
    }

    /// The runtimes that the program was built with.
    pub fn built() -> Vec<Self> {
        Self::ALL.into_iter().filter(|runtime| runtime.is_built()).collect()
    }

    /// The cargo feature that builds it in.
    pub fn feature(self) -> &'static str {
        self.built_by().0
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
            Self::Cpu => f.write_str("cpu"),
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
        let whole = match name {
            "auto" => Some(Self::Auto),
            "cpu" => Some(Self::Cpu),
            "flex" => Some(Self::Flex),
            "ndarray" => Some(Self::Ndarray),
            "gpu" if index.is_none() && !Runtime::built().is_empty() => Some(Self::Gpu),
            _ => None,
        };
        if let Some(device) = whole {
            return if index.is_none() {
                Ok(device)
            } else {
                Err(format!("only adapters have numbers: pass `{name}`"))
            };
        }
        let Some(runtime) = Runtime::ALL.into_iter().find(|runtime| runtime.prefix() == name) else {
            return Err(format!("there is no such device: pass {}", names()));
        };
        if !runtime.is_built() {
            let feature = runtime.feature();
            return Err(format!(
                "this program was built without the runtime `{feature}`: build it with `--features {feature}`, or pass {}",
                names()
            ));
        }
        let index =
            index.map(|index| index.parse().map_err(|_| format!("{index:?} is not a number, as in `{name}:0`")));
        Ok(Self::Adapter(runtime, index.transpose()?))
    }
}

/// Returns the help text of `--device`.
pub fn help() -> String {
    format!("Device to compute on: {}; `splat devices` lists them", names())
}

/// The values that this build accepts, as a list in a sentence.
fn names() -> String {
    let mut names = ["auto", "cpu", "flex", "ndarray"].map(String::from).to_vec();
    let built = Runtime::built();
    names.extend((!built.is_empty()).then(|| "gpu".into()));
    names.extend(built.iter().map(|runtime| match runtime {
        Runtime::Wgpu => "gpu:N".into(),
        runtime => format!("{}[:N]", runtime.prefix()),
    }));
    let last = names.pop().unwrap_or_default();
    format!("{} or {last}", names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_they_are_written() {
        let mut all = vec![DeviceName::Auto, DeviceName::Cpu, DeviceName::Flex, DeviceName::Ndarray];
        if let Some(runtime) = Runtime::built().into_iter().next() {
            all.extend([DeviceName::Gpu, DeviceName::Adapter(runtime, Some(12))]);
        }
        for device in all {
            assert_eq!(device.to_string().parse(), Ok(device));
        }
    }

    #[test]
    fn refusals_say_what_to_pass() {
        let refusal = |text: &str| text.parse::<DeviceName>().expect_err(text);
        for text in ["", "CPU", "gpux", "gpus:1", ":0", "vulkan "] {
            assert!(refusal(text).contains("auto, cpu"), "{text:?}: {}", refusal(text));
        }
        assert!(refusal("cpu:0").contains("pass `cpu`"));
        for runtime in Runtime::ALL {
            let name = format!("{}:x", runtime.prefix());
            let expected =
                if runtime.is_built() { "is not a number".into() } else { format!("--features {}", runtime.feature()) };
            assert!(refusal(&name).contains(&expected), "{name}: {}", refusal(&name));
        }
    }

    #[cfg(feature = "wgpu")]
    #[test]
    fn numbers_are_whole() {
        for text in ["gpu:", "gpu:-1", "gpu:1.5", "gpu:one", "gpu:0:0"] {
            assert!(text.parse::<DeviceName>().expect_err(text).contains("`gpu:0`"), "{text}");
        }
        assert_eq!("gpu:3".parse(), Ok(DeviceName::Adapter(Runtime::Wgpu, Some(3))));
    }
}
