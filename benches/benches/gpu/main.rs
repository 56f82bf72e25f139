//! Each stage forwards and backwards, the loss, and a whole training step, on devices named at run time. A scene that is
//! not what the figures are specified for, or a picture that is not the CPU's, is not timed.
//!
//! `cargo bench --workspace --bench gpu -- flex gpu fox_small`: any of `splat devices` and any of `fox_small`, `medium` and
//! `large`; without, flex and the GPU, and all sizes. The first device is what the others are compared with.

mod job;
mod measure;
mod passes;

use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use burn::tensor::Device;
use splat_benches::Load;
use splat_train::device::DeviceName;

use job::{Job, Size};
use measure::copy_bandwidth;
use passes::passes;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// For all passes of one size on one device. A driver in software needs it; a GPU is done long before.
const BUDGET: Duration = Duration::from_secs(60);

/// A device that is there.
struct Opened {
    name: String,
    device: Device,
    /// Of copies, bytes per second.
    bandwidth: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut names, mut sizes) = (Vec::<DeviceName>::new(), Vec::<Size>::new());
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
        sizes = Size::ALL.into();
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
    let bandwidth = copy_bandwidth(&device)?;
    println!("{name}: copies {:.1} GB/s, read and written", bandwidth / 1e9);
    Ok(Opened { name, device, bandwidth })
}

/// Verifies, then times, one size on all devices.
fn run(size: Size, devices: &[Opened]) -> Result<(), Box<dyn Error>> {
    let job = Job::new(size)?;
    let load = job.verify_load();
    let (width, height) = (job.intrinsics.width, job.intrinsics.height);
    println!("\n{size}: {} Gaussians at {width} × {height}", load.splats);
    let Load { visible, hits, layers, .. } = load;
    println!(
        "  {visible} visible ({:.1}%), {hits} hits ({:.2} per visible), {layers:.1} layers per pixel",
        100.0 * load.visible_share(),
        load.hits_per_visible()
    );
    // Medians of the first device.
    let mut base = Vec::new();
    for opened in devices {
        println!("\n {size} on {}", opened.name);
        // What depends on the data and does not fit is found deep within an operation; Burn hands the panic to whoever
        // waits for the device.
        let found = catch_unwind(AssertUnwindSafe(|| table(&job, &load, opened, &base)));
        let medians = found.unwrap_or_else(|panic| Err(message(panic.as_ref()).into()));
        match medians {
            Ok(medians) if base.is_empty() => base = medians,
            Ok(_) => {}
            Err(error) => println!("  does not fit, skipped: {error}"),
        }
    }
    Ok(())
}

/// Prints a line per pass and returns the medians.
fn table(job: &Job, load: &Load, opened: &Opened, base: &[f64]) -> Result<Vec<f64>, Box<dyn Error>> {
    let Opened { device, bandwidth, .. } = opened;
    job.check_fits(device)?;
    if job.size == Size::FoxSmall {
        job.verify_picture(device)?;
    }
    let mut passes = passes(job, load, device)?;
    println!(
        "  {:<21}{:>10}{:>6}{:>11}{:>9}{:>9}{:>9}",
        "pass", "median ms", "runs", "least MiB", "GB/s", "of copy", "× first"
    );
    let budget = BUDGET / passes.len() as u32;
    let mut medians = Vec::new();
    for (i, pass) in passes.iter_mut().enumerate() {
        let times = pass.time(device, budget)?;
        let rate = pass.bytes as f64 / times.median_s;
        let ratio = base.get(i).map_or("-".into(), |first| format!("{:.2}", times.median_s / first));
        println!(
            "  {:<21}{:>10.2}{:>6}{:>11.1}{:>9.3}{:>8.1}%{ratio:>9}",
            pass.name,
            1e3 * times.median_s,
            times.runs,
            pass.bytes as f64 / f64::from(1 << 20),
            rate / 1e9,
            100.0 * rate / bandwidth,
        );
        medians.push(times.median_s);
    }
    Ok(medians)
}

/// What a panic says.
fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without words").to_owned()
}
