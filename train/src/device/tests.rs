use anyhow::anyhow;

use super::*;

fn adapter(runtime: &'static str, index: usize, kind: AdapterKind) -> Adapter {
    Adapter { runtime, index, kind, device: Device::flex() }
}

#[cfg(feature = "wgpu")]
fn chosen(name: &str, adapters: &[Adapter]) -> String {
    match name.parse::<DeviceName>().unwrap().admitted(adapters) {
        Ok(found) => found.first().map_or("cpu".into(), |adapter| adapter.name()),
        Err(error) => error.to_string(),
    }
}

#[test]
fn names_are_read_as_they_are_written_and_refusals_say_what_to_pass() {
    for name in ["auto", "flex", "ndarray"] {
        assert_eq!(name.parse::<DeviceName>().unwrap().to_string(), name);
    }
    let refusal = |text: &str| text.parse::<DeviceName>().expect_err(text);
    for text in ["", "CPU", "gpux", "gpus:1", ":0", "vulkan ", "cpu:0", "auto:1"] {
        assert!(refusal(text).contains("auto, cpu"), "{text:?}: {}", refusal(text));
    }
    for runtime in RUNTIMES {
        let prefix = if runtime == "wgpu" { "gpu" } else { runtime };
        for index in ["", "x", "-1", "1.5", "0:0"] {
            let name = format!("{prefix}:{index}");
            assert!(refusal(&name).contains("auto, cpu"), "{name}: {}", refusal(&name));
        }
        match format!("{prefix}:7").parse::<DeviceName>() {
            Ok(name) => assert!(built().any(|built| built == runtime) && name.to_string() == format!("{prefix}:7")),
            Err(refused) => assert!(refused.contains(&format!("--features {runtime}")), "{refused}"),
        }
    }
}

#[cfg(feature = "wgpu")]
#[test]
fn auto_takes_a_gpu_and_gpu_takes_anything() {
    use AdapterKind::{Discrete, Integrated, Software, Unknown, Virtual};
    let kinds = [Software, Unknown, Virtual, Integrated, Discrete, Discrete];
    let all: Vec<Adapter> = kinds.into_iter().enumerate().map(|(i, kind)| adapter("wgpu", i, kind)).collect();
    for (count, auto, gpu) in [(6, "gpu:4", "gpu:4"), (4, "gpu:3", "gpu:3"), (3, "gpu:2", "gpu:2"), (2, "cpu", "gpu:1")]
    {
        assert_eq!((chosen("auto", &all[..count]), chosen("gpu", &all[..count])), (auto.into(), gpu.into()), "{count}");
    }
    assert_eq!([chosen("auto", &[]), chosen("cpu", &all), chosen("ndarray", &all)], ["cpu"; 3].map(String::from));
    assert_eq!((chosen("gpu:1", &all), chosen("wgpu", &all)), ("gpu:1".into(), "gpu:4".into()));
    // The maker's own runtime comes first among those of one card, the better card before that.
    let card = ["wgpu", "vulkan", "cuda"].map(|runtime| adapter(runtime, 0, Discrete));
    assert_eq!((chosen("auto", &card), chosen("auto", &card[..2])), ("cuda:0".into(), "vulkan:0".into()));
    assert_eq!(chosen("gpu", &[adapter("wgpu", 0, Discrete), adapter("vulkan", 0, Software)]), "gpu:0");
    for part in ["--device gpu:6", "gpu:5", "Install", "--device cpu"] {
        assert!(chosen("gpu:6", &all).contains(part), "{part}: {}", chosen("gpu:6", &all));
    }
    assert!(chosen("gpu:1", &card[2..]).contains("looked for it among [cuda:0]"));
}

#[test]
fn auto_goes_on_where_an_adapter_does_not_open() {
    let opened = |name: &str, broken: &[usize]| {
        let kinds = [AdapterKind::Discrete, AdapterKind::Integrated, AdapterKind::Software];
        let all: Vec<Adapter> = kinds.into_iter().enumerate().map(|(i, kind)| adapter("wgpu", i, kind)).collect();
        let mut said = Vec::new();
        let open = |adapter: &Adapter| match broken.contains(&adapter.index) {
            true => Err(anyhow!("driver\nlost")),
            false => Ok(adapter.index),
        };
        (DeviceName(name.into()).choose_and_open(&all, open, |line| said.push(line.to_owned())), said)
    };
    assert!(matches!(opened("auto", &[1]), (Ok(Some(0)), said) if said.is_empty()));
    let (found, said) = opened("auto", &[0]);
    assert_eq!((found.unwrap(), said), (Some(1), vec!["going on without `gpu:0`: driver lost".to_owned()]));
    let (found, said) = opened("auto", &[0, 1, 2]);
    assert_eq!((found.unwrap(), &said[1][..]), (None, "going on without `gpu:1`: driver lost"));
    // What was asked for by name is not replaced.
    for name in ["gpu", "gpu:0", "wgpu"] {
        let (found, said) = opened(name, &[0]);
        assert!(found.unwrap_err().to_string().contains("lost") && said.is_empty());
    }
}
