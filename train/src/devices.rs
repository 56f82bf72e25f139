//! `splat devices`: lists the devices to compute on.

use std::num::NonZero;
use std::thread;

use anyhow::Result;
use indicatif::BinaryBytes;

use crate::device::{self, DeviceName, RUNTIMES};
use crate::progress::say;

/// Prints the devices, the runtimes of this build, and the device that `auto` chooses.
pub fn run() -> Result<()> {
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    say(&line("--device", "what it is"));
    for name in ["flex", "ndarray"] {
        say(&line(name, &format!("the CPU through Burn's {name} backend, threads: {threads}")));
    }
    let found = device::list(&|_| true);
    let mut opened = Vec::new();
    for adapter in &found {
        let text = match device::open(adapter) {
            Ok(hardware) => {
                opened.push(adapter.clone());
                format!("{hardware}; buffers up to {}", BinaryBytes(splat_op::largest_tensor(&adapter.device)))
            }
            Err(error) => error.to_string(),
        };
        say(&line(&adapter.name(), &text));
    }
    say("");
    say(&match DeviceName::default().admitted(&opened)?.first() {
        Some(adapter) => format!("`--device auto` takes {}.", adapter.name()),
        None => "`--device auto` takes the CPU, flex: there is no GPU but those that only `--device gpu` takes.".into(),
    });
    let features = |is_built: bool| {
        let of: Vec<&str> =
            RUNTIMES.into_iter().filter(|of| device::built().any(|built| built == *of) == is_built).collect();
        if of.is_empty() { "none".into() } else { of.join(", ") }
    };
    say(&format!("GPU runtimes in this program: {}.", features(true)));
    say(&format!("Others can be built in, as cargo features: {}.", features(false)));
    let advice = "gpu".parse::<DeviceName>().map(|gpu| gpu.admitted(&found).err());
    if let Ok(Some(advice)) = advice {
        say(&advice.to_string());
    }
    Ok(())
}

fn line(name: &str, text: &str) -> String {
    format!("{name:12}{text}")
}
