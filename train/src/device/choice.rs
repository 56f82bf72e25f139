//! Choice of an adapter by name.

use std::fmt::{self, Display};

use anyhow::{Result, anyhow};

use super::{DeviceName, Runtime};

/// Kind of an adapter, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A graphics card.
    Discrete,
    /// A GPU that is part of the processor.
    Integrated,
    /// A GPU of a virtual machine.
    Virtual,
    /// The driver does not report a kind.
    Unknown,
    /// A driver that renders on the CPU.
    Software,
}

impl AdapterKind {
    /// Whether it is certainly a GPU.
    fn is_gpu(self) -> bool {
        self <= Self::Virtual
    }
}

impl Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // In the order of the variants.
        f.write_str(["discrete", "integrated", "virtual", "unknown", "software"][*self as usize])
    }
}

/// An adapter, one line of `splat devices`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Adapter {
    /// Runtime that reaches it. A card that two runtimes reach is two adapters.
    pub runtime: Runtime,
    /// Index among the adapters of its runtime.
    pub index: usize,
    /// Kind of the adapter.
    pub kind: AdapterKind,
}

impl Adapter {
    /// The value of `--device` that selects this adapter.
    pub fn name(&self) -> DeviceName {
        DeviceName::Adapter(self.runtime, Some(self.index))
    }
}

/// Returns the adapter that a name selects; `None` for the CPU.
///
/// # Errors
/// If a GPU is asked for and no adapter matches; the message names the drivers looked for and the remedy.
pub fn choose(name: DeviceName, adapters: &[Adapter]) -> Result<Option<Adapter>> {
    let best = |admitted: &dyn Fn(&Adapter) -> bool| {
        let admitted = adapters.iter().filter(|adapter| admitted(adapter));
        admitted.min_by_key(|adapter| (adapter.kind, adapter.runtime, adapter.index)).copied()
    };
    match name {
        DeviceName::Cpu | DeviceName::Flex | DeviceName::Ndarray => Ok(None),
        DeviceName::Auto => Ok(best(&|adapter| adapter.kind.is_gpu())),
        DeviceName::Gpu => best(&|_| true).map(Some).ok_or_else(|| nothing_found(name, &Runtime::built())),
        DeviceName::Adapter(runtime, None) => {
            best(&|adapter| adapter.runtime == runtime).map(Some).ok_or_else(|| nothing_found(name, &[runtime]))
        }
        DeviceName::Adapter(runtime, Some(index)) => {
            let count = adapters.iter().filter(|adapter| adapter.runtime == runtime).count();
            match best(&|adapter| adapter.name() == name) {
                Some(adapter) => Ok(Some(adapter)),
                None if count == 0 => Err(nothing_found(name, &[runtime])),
                None => Err(out_of_range(runtime, index, count)),
            }
        }
    }
}

/// Opens the adapter that a name selects; `None` for the CPU. Where `auto` selects one that does not open, the next best is tried, then the
/// CPU, and `say` receives a line about each.
///
/// # Errors
/// Those of [`choose`], and if an adapter that was asked for does not open.
pub fn choose_and_open<T>(
    name: DeviceName,
    adapters: &[Adapter],
    mut open: impl FnMut(Adapter) -> Result<T>,
    mut say: impl FnMut(&str),
) -> Result<Option<T>> {
    let mut left = adapters.to_vec();
    while let Some(adapter) = choose(name, &left)? {
        match open(adapter) {
            Ok(opened) => return Ok(Some(opened)),
            Err(error) if name == DeviceName::Auto => {
                let why = format!("{error:#}").replace('\n', " ");
                left.retain(|other| *other != adapter);
                let next = choose(name, &left)?.map_or("the CPU".into(), |next| format!("`{}`", next.name()));
                say(&format!("going on with {next}: {why}"));
            }
            Err(error) => return Err(error),
        }
    }
    Ok(None)
}

fn out_of_range(runtime: Runtime, index: usize, count: usize) -> anyhow::Error {
    let prefix = runtime.prefix();
    let range = match count {
        1 => format!("there is only `{prefix}:0`"),
        count => format!("numbers go from `{prefix}:0` to `{prefix}:{}`", count - 1),
    };
    anyhow!("there is no adapter `{prefix}:{index}`: {range}; `splat devices` lists all devices")
}

fn nothing_found(name: DeviceName, runtimes: &[Runtime]) -> anyhow::Error {
    if runtimes.is_empty() {
        return anyhow!(
            "this program is built for the CPU only: build it with its default features, or pass `--device cpu`"
        );
    }
    let looked_for: Vec<&str> = runtimes.iter().map(|runtime| looked_for(*runtime)).collect();
    let mut advice: Vec<&str> = runtimes.iter().map(|runtime| advice(*runtime)).collect();
    // Wgpu alone and wgpu with Vulkan need the same driver.
    advice.dedup();
    anyhow!(
        "`--device {name}` finds no adapter: looked for {}. Install {}; or pass `--device cpu`",
        looked_for.join(", "),
        advice.join(", or ")
    )
}

/// The drivers that a runtime looks for on this system.
fn looked_for(runtime: Runtime) -> &'static str {
    match runtime {
        Runtime::Wgpu if cfg!(target_os = "macos") => "Metal adapters",
        Runtime::Wgpu if cfg!(windows) => "Vulkan, DirectX 12 and OpenGL adapters",
        Runtime::Wgpu => "Vulkan and OpenGL adapters",
        Runtime::Vulkan => "Vulkan adapters",
        Runtime::Metal => "Metal adapters",
        Runtime::Cuda => "NVIDIA cards through the library `libcuda`",
        Runtime::Rocm => "AMD cards through the library `libamdhip64`",
    }
}

fn advice(runtime: Runtime) -> &'static str {
    match runtime {
        Runtime::Wgpu | Runtime::Vulkan if cfg!(target_os = "linux") => {
            "the GPU's Vulkan driver and the loader (Debian and Ubuntu: `libvulkan1`, with `mesa-vulkan-drivers` for \
             AMD, Intel and a driver in software, or NVIDIA's own driver)"
        }
        Runtime::Wgpu | Runtime::Vulkan => "the GPU's driver",
        Runtime::Metal => "macOS, the only system with Metal",
        Runtime::Cuda => "NVIDIA's driver",
        Runtime::Rocm => "AMD's ROCm",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(runtime: Runtime, index: usize, kind: AdapterKind) -> Adapter {
        Adapter { runtime, index, kind }
    }

    fn chosen(name: DeviceName, adapters: &[Adapter]) -> Option<Adapter> {
        choose(name, adapters).expect("there is one")
    }

    fn refused(name: DeviceName, adapters: &[Adapter]) -> String {
        choose(name, adapters).expect_err("there is none").to_string()
    }

    const WGPU: Runtime = Runtime::Wgpu;

    #[test]
    fn auto_takes_the_best_gpu_wherever_it_is_listed() {
        let kinds = [
            AdapterKind::Software,
            AdapterKind::Unknown,
            AdapterKind::Virtual,
            AdapterKind::Integrated,
            AdapterKind::Discrete,
            AdapterKind::Discrete,
        ];
        let all: Vec<Adapter> = kinds.into_iter().enumerate().map(|(i, kind)| adapter(WGPU, i, kind)).collect();
        assert_eq!(chosen(DeviceName::Auto, &all), Some(all[4]), "the first of the discrete ones");
        assert_eq!(chosen(DeviceName::Auto, &all[..4]), Some(all[3]), "else an integrated one");
        assert_eq!(chosen(DeviceName::Auto, &all[..3]), Some(all[2]), "else a virtual one");
    }

    #[test]
    fn auto_takes_the_cpu_rather_than_a_driver_in_software() {
        assert_eq!(chosen(DeviceName::Auto, &[]), None);
        let doubtful = [adapter(WGPU, 0, AdapterKind::Software), adapter(WGPU, 1, AdapterKind::Unknown)];
        assert_eq!(chosen(DeviceName::Auto, &doubtful), None);
    }

    /// The adapter that opens where some do not, or `None`, and what is said.
    fn opened(name: DeviceName, adapters: &[Adapter], broken: &[Adapter]) -> (Result<Option<Adapter>>, Vec<String>) {
        let mut said = Vec::new();
        let open = |adapter: Adapter| match broken.contains(&adapter) {
            true => Err(anyhow!("cannot open the adapter `{}`:\nlost", adapter.name())),
            false => Ok(adapter),
        };
        let found = choose_and_open(name, adapters, open, |line| said.push(line.to_owned()));
        (found, said)
    }

    #[test]
    fn auto_goes_on_where_an_adapter_does_not_open() {
        let card = adapter(WGPU, 0, AdapterKind::Discrete);
        let inside = adapter(WGPU, 1, AdapterKind::Integrated);
        let all = [adapter(WGPU, 2, AdapterKind::Software), inside, card];
        let of = |broken: &[Adapter]| opened(DeviceName::Auto, &all, broken);
        assert!(matches!(of(&[]), (Ok(Some(found)), said) if found == card && said.is_empty()));
        assert!(matches!(of(&[inside]), (Ok(Some(found)), said) if found == card && said.is_empty()));
        let (found, said) = of(&[card]);
        assert_eq!(found.unwrap(), Some(inside));
        assert_eq!(said, ["going on with `gpu:1`: cannot open the adapter `gpu:0`: lost"]);
        let (found, said) = of(&all);
        assert_eq!(found.unwrap(), None, "a driver in software is not tried");
        assert!(
            said.len() == 2 && said[1] == "going on with the CPU: cannot open the adapter `gpu:1`: lost",
            "{said:?}"
        );
        // What was asked for by name is not replaced.
        for name in [DeviceName::Gpu, DeviceName::Adapter(WGPU, Some(0)), DeviceName::Adapter(WGPU, None)] {
            let (found, said) = opened(name, &all, &[card]);
            assert!(found.unwrap_err().to_string().contains("`gpu:0`") && said.is_empty());
        }
    }

    #[test]
    fn names_of_the_cpu_never_take_a_gpu() {
        let card = [adapter(WGPU, 0, AdapterKind::Discrete)];
        for name in [DeviceName::Cpu, DeviceName::Flex, DeviceName::Ndarray] {
            assert_eq!(chosen(name, &card), None);
        }
    }

    #[test]
    fn gpu_takes_software_if_there_is_nothing_better() {
        let software = adapter(WGPU, 0, AdapterKind::Software);
        let card = adapter(WGPU, 1, AdapterKind::Integrated);
        assert_eq!(chosen(DeviceName::Gpu, &[software]), Some(software));
        assert_eq!(chosen(DeviceName::Gpu, &[software, card]), Some(card));
        let unknown = adapter(WGPU, 2, AdapterKind::Unknown);
        assert_eq!(chosen(DeviceName::Gpu, &[software, unknown]), Some(unknown));
    }

    #[test]
    fn of_one_card_the_maker_s_own_runtime_is_taken_and_the_better_card_before_that() {
        let card = [WGPU, Runtime::Vulkan, Runtime::Cuda].map(|runtime| adapter(runtime, 0, AdapterKind::Discrete));
        assert_eq!(chosen(DeviceName::Auto, &card), Some(card[2]));
        assert_eq!(chosen(DeviceName::Auto, &card[..2]), Some(card[1]));
        let mixed = [adapter(WGPU, 0, AdapterKind::Discrete), adapter(Runtime::Vulkan, 0, AdapterKind::Software)];
        assert_eq!(chosen(DeviceName::Gpu, &mixed), Some(mixed[0]));
    }

    #[test]
    fn a_runtime_takes_the_best_of_its_own() {
        let all = [
            adapter(WGPU, 0, AdapterKind::Discrete),
            adapter(Runtime::Vulkan, 0, AdapterKind::Software),
            adapter(Runtime::Vulkan, 1, AdapterKind::Integrated),
        ];
        assert_eq!(chosen(DeviceName::Adapter(Runtime::Vulkan, None), &all), Some(all[2]));
        assert_eq!(chosen(DeviceName::Adapter(Runtime::Vulkan, Some(0)), &all), Some(all[1]));
        assert_eq!(chosen(DeviceName::Adapter(WGPU, Some(0)), &all), Some(all[0]));
    }

    #[test]
    fn a_number_beyond_the_last_names_the_range() {
        let all = [
            adapter(WGPU, 0, AdapterKind::Discrete),
            adapter(WGPU, 1, AdapterKind::Software),
            adapter(Runtime::Cuda, 0, AdapterKind::Discrete),
        ];
        let message = refused(DeviceName::Adapter(WGPU, Some(2)), &all);
        assert!(message.contains("`gpu:2`") && message.contains("`gpu:0` to `gpu:1`"), "{message}");
        let message = refused(DeviceName::Adapter(Runtime::Cuda, Some(7)), &all);
        assert!(message.contains("`cuda:7`") && message.contains("only `cuda:0`"), "{message}");
    }

    #[test]
    fn without_any_the_message_says_what_was_looked_for_and_what_to_do() {
        let cuda = [adapter(Runtime::Cuda, 0, AdapterKind::Discrete)];
        for name in [DeviceName::Adapter(Runtime::Vulkan, None), DeviceName::Adapter(Runtime::Vulkan, Some(1))] {
            let message = refused(name, &cuda);
            for part in [&format!("--device {name}"), "looked for Vulkan", "Install", "--device cpu"] {
                assert!(message.contains(part), "{message}");
            }
        }
        assert!(refused(DeviceName::Gpu, &[]).contains("--device cpu"));
    }
}
