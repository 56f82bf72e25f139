use anyhow::anyhow;

use super::*;

const WGPU: Runtime = Runtime::Wgpu;

fn adapter(runtime: Runtime, index: usize, kind: AdapterKind) -> Adapter {
    Adapter { runtime, index, kind, device: Device::flex() }
}

fn chosen(name: &str, adapters: &[Adapter]) -> String {
    match choose(name.parse().unwrap(), adapters) {
        Ok(found) => found.map_or("cpu".into(), |adapter| adapter.name().to_string()),
        Err(error) => error.to_string(),
    }
}

#[test]
fn names_are_read_as_they_are_written_and_refusals_say_what_to_pass() {
    for name in ["auto", "flex", "ndarray"] {
        assert_eq!(name.parse::<DeviceName>().unwrap().to_string(), name);
    }
    let refusal = |text: &str| text.parse::<DeviceName>().expect_err(text);
    for text in ["", "CPU", "gpux", "gpus:1", ":0", "vulkan "] {
        assert!(refusal(text).contains("auto, cpu"), "{text:?}: {}", refusal(text));
    }
    assert!(refusal("cpu:0").contains("pass `cpu`"));
    for runtime in Runtime::ALL {
        let is_built = Runtime::built().contains(&runtime);
        let expected = if is_built { "is not a number".into() } else { format!("--features {}", runtime.feature()) };
        for index in ["", "x", "-1", "1.5", "0:0"] {
            let name = format!("{}:{index}", runtime.prefix());
            assert!(refusal(&name).contains(&expected), "{name}: {}", refusal(&name));
        }
    }
}

#[cfg(feature = "wgpu")]
#[test]
fn auto_takes_a_gpu_and_gpu_takes_anything() {
    use AdapterKind::{Discrete, Integrated, Software, Unknown, Virtual};
    let kinds = [Software, Unknown, Virtual, Integrated, Discrete, Discrete];
    let all: Vec<Adapter> = kinds.into_iter().enumerate().map(|(i, kind)| adapter(WGPU, i, kind)).collect();
    for (count, auto, gpu) in [(6, "gpu:4", "gpu:4"), (4, "gpu:3", "gpu:3"), (3, "gpu:2", "gpu:2"), (2, "cpu", "gpu:1")]
    {
        assert_eq!((chosen("auto", &all[..count]), chosen("gpu", &all[..count])), (auto.into(), gpu.into()), "{count}");
    }
    assert_eq!([chosen("auto", &[]), chosen("cpu", &all), chosen("ndarray", &all)], ["cpu"; 3].map(String::from));
    assert_eq!(chosen("gpu:1", &all), "gpu:1");
    // The maker's own runtime comes first among those of one card, the better card before that.
    let card = [WGPU, Runtime::Vulkan, Runtime::Cuda].map(|runtime| adapter(runtime, 0, Discrete));
    assert_eq!((chosen("auto", &card), chosen("auto", &card[..2])), ("cuda:0".into(), "vulkan:0".into()));
    assert_eq!(chosen("gpu", &[adapter(WGPU, 0, Discrete), adapter(Runtime::Vulkan, 0, Software)]), "gpu:0");
    assert!(chosen("gpu:6", &all).contains("`gpu:6`: the last has the number 5"), "{}", chosen("gpu:6", &all));
    for part in ["--device gpu:1", "looked for", "Install", "--device cpu"] {
        assert!(chosen("gpu:1", &card[2..]).contains(part), "{part}: {}", chosen("gpu:1", &card[2..]));
    }
}

#[test]
fn auto_goes_on_where_an_adapter_does_not_open() {
    let opened = |name: DeviceName, broken: &[usize]| {
        let kinds = [AdapterKind::Discrete, AdapterKind::Integrated, AdapterKind::Software];
        let all = kinds.into_iter().enumerate().map(|(i, kind)| adapter(WGPU, i, kind)).collect();
        let mut said = Vec::new();
        let open = |adapter: &Adapter| match broken.contains(&adapter.index) {
            true => Err(anyhow!("`{}`:\nlost", adapter.name())),
            false => Ok(adapter.index),
        };
        (choose_and_open(name, all, open, |line| said.push(line.to_owned())), said)
    };
    assert!(matches!(opened(DeviceName::Auto, &[1]), (Ok(Some(0)), said) if said.is_empty()));
    let (found, said) = opened(DeviceName::Auto, &[0]);
    assert_eq!((found.unwrap(), said), (Some(1), vec!["going on with `gpu:1`: `gpu:0`: lost".to_owned()]));
    let (found, said) = opened(DeviceName::Auto, &[0, 1, 2]);
    assert_eq!((found.unwrap(), &said[1][..]), (None, "going on with the CPU: `gpu:1`: lost"));
    // What was asked for by name is not replaced.
    for name in [DeviceName::Gpu, DeviceName::Adapter(WGPU, Some(0)), DeviceName::Adapter(WGPU, None)] {
        let (found, said) = opened(name, &[0]);
        assert!(found.unwrap_err().to_string().contains("`gpu:0`") && said.is_empty());
    }
}
