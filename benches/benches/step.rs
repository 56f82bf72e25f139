//! Times a whole training step: render, loss, backward, Adam. Before that, a run is checked to train.
//!
//! `cargo bench --workspace --bench step -- medium` takes any of `small`, `fox_small`, `fox_colmap`, `medium` and `large`, by
//! default `small` and `medium`.
//!
//! `cargo bench --workspace --bench step -- --profile` prints where a step spends its time, as a table for the README: each pass,
//! timed within the step, and the remaining time. The default scenes are `fox_small`, `fox_colmap` and `large`.

use std::cell::RefCell;
use std::error::Error;
use std::rc::Rc;
use std::time::Duration;

use burn::tensor::Device;
use splat_benches::SMALL;
use splat_benches::job::{Job, JobSize};
use splat_benches::limit::{Machine, PassKind};
use splat_benches::measure::{PassResult, Prepare, table, time};
use splat_benches::passes::whole_step;
use splat_benches::pieces::Pieces;
use splat_model::loss::Truth;

splat_train::allocator!();

/// Time budget for one size.
const BUDGET: Duration = Duration::from_secs(15);
const PROFILE_BUDGET: Duration = Duration::from_secs(40);

fn main() -> Result<(), Box<dyn Error>> {
    let profile = std::env::args().any(|word| word == "--profile");
    let (device, machine) = (Device::flex(), Machine::measure());
    println!("{} threads: {machine}", rayon::current_num_threads());
    if profile {
        let sizes = JobSize::from_arguments(&[JobSize::FoxSmall, JobSize::FoxColmap, JobSize::Large])?;
        let measured: Result<Vec<_>, _> = sizes.into_iter().map(|size| measure(size, &device, &machine)).collect();
        print_profile(&measured?);
        return Ok(());
    }
    let sizes = JobSize::from_arguments(&[JobSize::Small, JobSize::Medium])?;
    verify()?;
    for size in sizes {
        let job = Job::new(size)?;
        let load = job.verify_load();
        println!("\n{size}, {} × {}: {load}", job.intrinsics.width, job.intrinsics.height);
        table(&mut [whole_step(&job, &device)], &device, &machine, &job.sizes(&load), BUDGET, &[])?;
    }
    Ok(())
}

/// Trains 200 steps on one picture of the synthetic scene and checks that the loss falls.
fn verify() -> Result<(), Box<dyn Error>> {
    let mut run = SMALL.trainer(1);
    let mut loss = || run.step().map(|step| step.loss.into_scalar::<f32>());
    let first = loss()?;
    let mut last = f32::NAN;
    for _ in 0..200 {
        last = loss()?;
    }
    assert!(last < 0.8 * first, "the loss went from {first} to {last}: this is not training");
    Ok(())
}

/// Times of a step of one size, pass by pass.
struct Profile {
    size: JobSize,
    /// Medians in seconds, in the order of [`PassKind::PARTS`].
    parts: Vec<f64>,
    /// Median of the whole step in seconds.
    step: f64,
    /// Limits in seconds, in the order of [`PassKind::PARTS`], then of the step.
    limits: Vec<f64>,
    /// Share of the processors' time that the whole step used.
    busy: f64,
}

/// Times whole steps and steps in pieces in turns, so that other load of the machine affects both.
fn measure(size: JobSize, device: &Device, machine: &Machine) -> Result<Profile, Box<dyn Error>> {
    let job = Job::new(size)?;
    let load = job.verify_load();
    println!("{size}, {} × {}: {load}", job.intrinsics.width, job.intrinsics.height);
    let sizes = job.sizes(&load);
    let gaussians = job.gaussians(&device.clone().autodiff());
    let truth = Truth::new(job.photograph(device));
    let mut pieces = Pieces::new(gaussians, job.camera(device), truth);
    let runs = Rc::new(RefCell::new(Vec::new()));
    let kept = runs.clone();
    let mut in_pieces: Prepare = Box::new(move || {
        let seconds = pieces.run()?.seconds;
        kept.borrow_mut().push(seconds);
        Ok(Box::new(|| Ok(Box::new(()) as PassResult)))
    });
    let mut whole = whole_step(&job, device);
    let times = time([&mut whole.prepare, &mut in_pieces], device, PROFILE_BUDGET)?;
    let runs = runs.borrow();
    let median = |part: usize| {
        // Steps in pieces that ran in turns with the warm-up of the whole step are not counted either.
        let mut seconds: Vec<f64> = runs[runs.len() - times[0].runs..].iter().map(|run| run[part]).collect();
        seconds.sort_by(f64::total_cmp);
        seconds[seconds.len() / 2]
    };
    let limits = PassKind::PARTS.into_iter().chain([PassKind::Step]).map(|kind| sizes.limit(kind, machine)).collect();
    let parts = (0..PassKind::PARTS.len()).map(median).collect();
    Ok(Profile { size, parts, step: times[0].median_s, limits, busy: times[0].busy })
}

/// Prints a table in Markdown. The time outside the passes is Burn's: its graph, slices of tensors and sums of gradients.
fn print_profile(profiles: &[Profile]) {
    let row = |name: &str, cell: &dyn Fn(&Profile) -> String| {
        let cells: Vec<String> = profiles.iter().map(cell).collect();
        println!("| {name} | {} |", cells.join(" | "));
    };
    println!();
    row("median ms (share of the step; times the limit)", &|profile| format!("`{}`", profile.size));
    println!("|---|{}", "---|".repeat(profiles.len()));
    for (i, kind) in PassKind::PARTS.into_iter().enumerate() {
        row(kind.name(), &|profile| {
            let median = profile.parts[i];
            let (share, ratio) = (100.0 * median / profile.step, median / profile.limits[i]);
            format!("{:.2} ({share:.1}%; {ratio:.1})", 1e3 * median)
        });
    }
    row("the rest: Burn's graph, slices, sums", &|profile| {
        let rest = profile.step - profile.parts.iter().sum::<f64>();
        format!("{:.2} ({:.1}%)", 1e3 * rest, 100.0 * rest / profile.step)
    });
    row("**training step**", &|profile| {
        let ratio = profile.step / profile.limits[PassKind::PARTS.len()];
        format!("**{:.1}** ({ratio:.1} times the limit)", 1e3 * profile.step)
    });
    row("processors' time not used", &|profile| format!("{:.0}%", 100.0 * (1.0 - profile.busy)));
}
