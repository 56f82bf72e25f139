//! A whole training step: render, loss, backward, Adam. A run is first compared with what it is known to reach.
//!
//! `cargo bench --workspace --bench step -- medium`: any of `small`, `fox_small`, `fox_colmap`, `medium` and `large`; without,
//! `small` and `medium`.
//!
//! `cargo bench --workspace --bench step -- --profile` says where a step spends its time, as a table for the README: each of its
//! passes alone, and what is left; without names on `fox_small`, `fox_colmap` and `large`.

use std::error::Error;
use std::time::Duration;

use burn::tensor::Device;
use splat_benches::SMALL;
use splat_benches::job::{Job, Size};
use splat_benches::limit::{Kind, Machine};
use splat_benches::measure::{Times, table};
use splat_benches::passes::{passes, whole_step};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// For one size.
const BUDGET: Duration = Duration::from_secs(15);
const PROFILE_BUDGET: Duration = Duration::from_secs(60);

fn main() -> Result<(), Box<dyn Error>> {
    let profile = std::env::args().any(|word| word == "--profile");
    let (device, machine) = (Device::flex(), Machine::measure());
    println!("{} threads: {machine}", rayon::current_num_threads());
    if profile {
        let sizes = Size::from_arguments(&[Size::FoxSmall, Size::FoxColmap, Size::Large])?;
        let measured: Result<Vec<_>, _> = sizes.into_iter().map(|size| measure(size, &device, &machine)).collect();
        print_profile(&measured?);
        return Ok(());
    }
    let sizes = Size::from_arguments(&[Size::Small, Size::Medium])?;
    verify()?;
    for size in sizes {
        let job = Job::new(size)?;
        let load = job.verify_load();
        println!("\n{size}, {} × {}: {load}", job.intrinsics.width, job.intrinsics.height);
        table(&mut [whole_step(&job, &device)], (&device, &machine), &job.sizes(&load), BUDGET, &[])?;
    }
    Ok(())
}

/// 200 steps on one picture of the synthetic scene.
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

/// A step of one size, pass by pass.
struct Profile {
    size: Size,
    /// By [`Kind::PARTS`], then the step.
    times: Vec<Times>,
    limits: Vec<f64>,
}

fn measure(size: Size, device: &Device, machine: &Machine) -> Result<Profile, Box<dyn Error>> {
    let job = Job::new(size)?;
    let load = job.verify_load();
    println!("\n{size}, {} × {}: {load}", job.intrinsics.width, job.intrinsics.height);
    let sizes = job.sizes(&load);
    let mut passes = passes(&job, device)?;
    let limits = passes.iter().map(|pass| sizes.limit(pass.kind, machine)).collect();
    let times = table(&mut passes, (device, machine), &sizes, PROFILE_BUDGET, &[])?;
    Ok(Profile { size, times, limits })
}

/// A table in Markdown. What is not in the passes is Burn's graph, its slices and sums of gradients, and the caches that a pass
/// finds warmer alone than among others.
fn print_profile(profiles: &[Profile]) {
    let row = |name: &str, cell: &dyn Fn(&Profile) -> String| {
        let cells: Vec<String> = profiles.iter().map(cell).collect();
        println!("| {name} | {} |", cells.join(" | "));
    };
    println!();
    row("median ms (share of the step; times the limit)", &|profile| format!("`{}`", profile.size));
    println!("|---|{}", "---|".repeat(profiles.len()));
    let step = |profile: &Profile| profile.times[Kind::PARTS.len()].median_s;
    for (i, kind) in Kind::PARTS.into_iter().enumerate() {
        row(kind.name(), &|profile| {
            let median = profile.times[i].median_s;
            let (share, ratio) = (100.0 * median / step(profile), median / profile.limits[i]);
            format!("{:.2} ({share:.1}%; {ratio:.0})", 1e3 * median)
        });
    }
    row("the rest: Burn's graph, slices, sums", &|profile| {
        let passes: f64 = profile.times[..Kind::PARTS.len()].iter().map(|times| times.median_s).sum();
        let rest = step(profile) - passes;
        format!("{:.2} ({:.1}%)", 1e3 * rest, 100.0 * rest / step(profile))
    });
    row("**training step**", &|profile| {
        let ratio = step(profile) / profile.limits[Kind::PARTS.len()];
        format!("**{:.1}** ({ratio:.0} times the limit)", 1e3 * step(profile))
    });
    row("processors idle", &|profile| format!("{:.0}%", 100.0 * (1.0 - profile.times[Kind::PARTS.len()].busy)));
}
