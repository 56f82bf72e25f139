//! Times each pass of a training step, and the whole step, on devices side by side.

use std::error::Error;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::time::Duration;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use splat_benches::Load;
use splat_benches::job::{Job, JobSize};
use splat_benches::limit::Machine;
use splat_benches::limit::PassKind;
use splat_benches::measure::{RunTimes, copy_bandwidth, table};
use splat_benches::passes::passes;
use splat_op::is_gpu;
use splat_train::device::DeviceName;

/// Time budget for all passes of one size on one device. Only a driver in software uses all of it.
const BUDGET: Duration = Duration::from_secs(60);

/// An opened device.
struct Opened {
    name: String,
    device: Device,
    /// Measured rates. For a GPU only the copy bandwidth is measured.
    machine: Machine,
}

/// A pass on a device, as `--json` writes it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TimedPass {
    pub scene: String,
    pub device: String,
    pub pass: String,
    pub median_ms: f64,
    pub runs: usize,
    /// Time of the least necessary work at the measured rates; for a GPU, of its bytes at the bandwidth of a copy.
    pub limit_ms: f64,
    /// Kernels that a run launches, and the bytes of the buffers that they are given; 0 on a CPU.
    pub launches: u64,
    pub bound_bytes: u64,
}

/// Times the scenes and devices that `words` name. `--json FILE` writes the times too.
///
/// # Errors
/// If a word names neither a scene nor a device, or a scene cannot be loaded. A device that does not open and a scene that does not
/// fit a device are skipped.
pub fn run(words: impl IntoIterator<Item = String>) -> Result<(), Box<dyn Error>> {
    let (mut names, mut sizes, mut json) = (Vec::<DeviceName>::new(), Vec::<JobSize>::new(), None);
    let mut words = words.into_iter();
    while let Some(word) = words.next() {
        match word.parse() {
            Ok(size) => sizes.push(size),
            Err(()) if word == "--json" => json = Some(PathBuf::from(words.next().ok_or("`--json` needs a file")?)),
            Err(()) => names.push(word.parse()?),
        }
    }
    if names.is_empty() {
        names = vec!["flex".parse()?, "gpu".parse()?];
    }
    if sizes.is_empty() {
        sizes = vec![JobSize::FoxSmall, JobSize::Medium, JobSize::Large];
    }
    let mut devices = Vec::new();
    for name in names {
        match open(&name) {
            Ok(opened) => devices.push(opened),
            Err(error) => println!("{name} is skipped: {error}"),
        }
    }
    let mut all = Vec::new();
    for size in sizes {
        all.extend(one_size(size, &devices)?);
        // After each scene: a driver may end the process in the next.
        if let Some(file) = &json {
            fs::write(file, serde_json::to_string_pretty(&all)?)?;
        }
    }
    Ok(())
}

fn open(name: &DeviceName) -> Result<Opened, Box<dyn Error>> {
    let (device, name) = name.resolve()?;
    let machine = match is_gpu(&device) {
        true => Machine { bandwidth: copy_bandwidth(&device)?, operations: None },
        false => Machine::measure(),
    };
    println!("{name}: {machine}");
    Ok(Opened { name, device, machine })
}

/// Verifies and then times one size on all devices.
fn one_size(size: JobSize, devices: &[Opened]) -> Result<Vec<TimedPass>, Box<dyn Error>> {
    let job = Job::new(size)?;
    let load = job.verify_load();
    let (width, height) = (job.intrinsics.width, job.intrinsics.height);
    println!("\n{size}, {width} × {height}: {load}");
    // Medians of the first device, the base of the comparison.
    let (mut base, mut all) = (Vec::new(), Vec::new());
    for opened in devices {
        println!("\n {size} on {}", opened.name);
        // A buffer whose size depends on the data can fail deep within an operation. Burn then passes the panic to the caller
        // that waits for the device.
        let found = catch_unwind(AssertUnwindSafe(|| timed(&job, &load, opened, &base)));
        match found.unwrap_or_else(|panic| Err(message(panic.as_ref()).into())) {
            Ok(times) => {
                if base.is_empty() {
                    base = times.iter().map(|(_, times)| times.median_s).collect();
                }
                all.extend(times.into_iter().map(|(kind, times)| TimedPass {
                    scene: size.to_string(),
                    device: opened.name.clone(),
                    pass: kind.name().into(),
                    median_ms: 1e3 * times.median_s,
                    runs: times.runs,
                    limit_ms: 1e3 * job.sizes(&load).limit(kind, &opened.machine),
                    launches: times.launches,
                    bound_bytes: times.bound_bytes,
                }));
            }
            Err(error) => println!("  does not fit, skipped: {error}"),
        }
    }
    Ok(all)
}

/// Times all passes, prints a line for each and returns the times.
fn timed(job: &Job, load: &Load, opened: &Opened, base: &[f64]) -> Result<Vec<(PassKind, RunTimes)>, Box<dyn Error>> {
    let Opened { device, machine, .. } = opened;
    if job.size == JobSize::FoxSmall {
        job.verify_picture(device)?;
    }
    job.check_fits(device)?;
    let mut passes = passes(job, device)?;
    let times = table(&mut passes, device, machine, &job.sizes(load), BUDGET, base)?;
    Ok(passes.iter().map(|pass| pass.kind).zip(times).collect())
}

/// Returns the message of a panic.
fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without a message").to_owned()
}
