//! `splat devices`: lists the devices to compute on.

use std::num::NonZero;
use std::thread;

use anyhow::Result;
use indicatif::BinaryBytes;

use crate::device::{self, DeviceName, Runtime, choose};
use crate::progress::say;

/// Prints the devices, the runtimes of this build, and the device that `auto` chooses.
///
/// # Errors
/// None today: an adapter that does not open is listed as such.
pub fn run() -> Result<()> {
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    say(&line("--device", "what it is"));
    for name in [DeviceName::Flex, DeviceName::Ndarray] {
        say(&line(&name.to_string(), &format!("the CPU through Burn's {name} backend, threads: {threads}")));
    }
    let found = device::list(&Runtime::built());
    let mut opened = Vec::new();
    for adapter in &found {
        let text = match device::open(adapter) {
            Ok(facts) => {
                opened.push(adapter.clone());
                let with = if facts.float_atomics { "with" } else { "without" };
                format!("{}; buffers up to {}, {with} f32 atomics", facts.summary, BinaryBytes(facts.buffer_limit))
            }
            Err(error) => format!("{}; {error}", adapter.kind),
        };
        say(&line(&adapter.name().to_string(), &text));
    }
    say("");
    say(&match choose(DeviceName::Auto, &opened)? {
        Some(adapter) => format!("`--device auto` takes {}.", adapter.name()),
        None => format!("`--device auto` takes the CPU, flex: {}.", device::why_cpu(&opened)),
    });
    let (built, other): (Vec<_>, Vec<_>) =
        Runtime::ALL.into_iter().partition(|runtime| Runtime::built().contains(runtime));
    let features = |runtimes: &[Runtime]| match runtimes {
        [] => "none".into(),
        some => some.iter().map(|runtime| runtime.feature()).collect::<Vec<_>>().join(", "),
    };
    say(&format!("GPU runtimes in this program: {}.", features(&built)));
    say(&format!("Others can be built in, as cargo features: {}.", features(&other)));
    if let (true, Err(advice)) = (found.is_empty() && !built.is_empty(), choose(DeviceName::Gpu, &found)) {
        say(&advice.to_string());
    }
    Ok(())
}

fn line(name: &str, text: &str) -> String {
    format!("{name:12}{text}")
}
