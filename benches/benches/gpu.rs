//! Times each pass of a training step, and the whole step, on devices named at run time. A scene outside the specified load,
//! or a picture that differs from the CPU's, is not timed.
//!
//! `cargo bench --workspace --bench gpu -- flex gpu fox_small` takes any names of `splat devices` and any of `small`,
//! `fox_small`, `fox_colmap`, `medium` and `large`. The default is flex and the GPU with `fox_small`, `medium` and `large`. All
//! devices are compared with the first.

use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use burn::tensor::Device;
use splat_benches::Load;
use splat_benches::job::{Job, JobSize};
use splat_benches::limit::Machine;
use splat_benches::measure::{copy_bandwidth, table};
use splat_benches::passes::{pair_counts, passes};
use splat_op::is_gpu;
use splat_train::device::DeviceName;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Time budget for all passes of one size on one device. Only a driver in software uses all of it.
const BUDGET: Duration = Duration::from_secs(60);

/// An opened device.
struct Opened {
    name: String,
    device: Device,
    /// Measured rates. For a GPU only the copy bandwidth is measured.
    machine: Machine,
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut names, mut sizes) = (Vec::<DeviceName>::new(), Vec::<JobSize>::new());
    // Cargo passes `--bench`.
    for word in std::env::args().skip(1).filter(|word| word != "--bench") {
        match word.parse() {
            Ok(size) => sizes.push(size),
            Err(()) => names.push(word.parse()?),
        }
    }
    if names.is_empty() {
        names = vec![DeviceName::Flex, DeviceName::Gpu];
    }
    if sizes.is_empty() {
        sizes = vec![JobSize::FoxSmall, JobSize::Medium, JobSize::Large];
    }
    let mut devices = Vec::new();
    for name in names {
        match open(name) {
            Ok(opened) => devices.push(opened),
            Err(error) => println!("{name} is skipped: {error}"),
        }
    }
    for size in sizes {
        run(size, &devices)?;
    }
    Ok(())
}

fn open(name: DeviceName) -> Result<Opened, Box<dyn Error>> {
    let (device, name) = name.resolve()?;
    let machine = match is_gpu(&device) {
        true => Machine { bandwidth: copy_bandwidth(&device)?, operations: None },
        false => Machine::measure(),
    };
    println!("{name}: {machine}");
    Ok(Opened { name, device, machine })
}

/// Verifies and then times one size on all devices.
fn run(size: JobSize, devices: &[Opened]) -> Result<(), Box<dyn Error>> {
    let job = Job::new(size)?;
    let load = job.verify_load();
    let (width, height) = (job.intrinsics.width, job.intrinsics.height);
    println!("\n{size}, {width} × {height}: {load}");
    // Medians of the first device, the base of the comparison.
    let mut base = Vec::new();
    for opened in devices {
        println!("\n {size} on {}", opened.name);
        // A buffer whose size depends on the data can fail deep within an operation. Burn then passes the panic to the caller
        // that waits for the device.
        let found = catch_unwind(AssertUnwindSafe(|| timed(&job, &load, opened, &base)));
        let medians = found.unwrap_or_else(|panic| Err(message(panic.as_ref()).into()));
        match medians {
            Ok(medians) if base.is_empty() => base = medians,
            Ok(_) => {}
            Err(error) => println!("  does not fit, skipped: {error}"),
        }
    }
    Ok(())
}

/// Times all passes, prints a line for each and returns the medians.
fn timed(job: &Job, load: &Load, opened: &Opened, base: &[f64]) -> Result<Vec<f64>, Box<dyn Error>> {
    let Opened { device, machine, .. } = opened;
    job.check_fits(device)?;
    if job.size == JobSize::FoxSmall {
        job.verify_picture(device)?;
    }
    if let Some(counts) = pair_counts(job, device)? {
        let each = |pairs: u64| pairs as f64 / counts.contributing as f64;
        println!(
            "  pairs of a pixel and a Gaussian: {:.1} million contribute; evaluated for each: {:.2} forwards, {:.2} backwards",
            counts.contributing as f64 / 1e6,
            each(counts.evaluated_forwards),
            each(counts.evaluated_backwards)
        );
    }
    let mut passes = passes(job, device)?;
    let times = table(&mut passes, (device, machine), &job.sizes(load), BUDGET, base)?;
    Ok(times.into_iter().map(|times| times.median_s).collect())
}

/// Returns the message of a panic.
fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without a message").to_owned()
}
