//! Measures times, including the wait for the device, and prints them as a table.

use std::any::Any;
use std::cell::RefCell;
use std::error::Error;
use std::rc::Rc;
use std::time::{Duration, Instant};

use burn::tensor::{Device, Tensor};
use splat_op::test_hooks::{self, dispatches};

use crate::limit::{Machine, PassKind, Sizes};

/// Result of a pass, freed outside the timed part.
pub type PassResult = Box<dyn Any>;

/// Timed part of a run. Its errors are errors of the op.
pub type TimedPart = Box<dyn FnOnce() -> Result<PassResult, Box<dyn Error>>>;

/// Prepares a run, untimed, and returns the timed part.
pub type Prepare = Box<dyn FnMut() -> Result<TimedPart, Box<dyn Error>>>;

/// Prepares runs of a function that changes its state from run to run.
pub fn stateful<S: 'static, T: 'static, E: Error + 'static>(
    state: S,
    run: impl Fn(&mut S) -> Result<T, E> + Copy + 'static,
) -> Prepare {
    let state = Rc::new(RefCell::new(state));
    Box::new(move || {
        let state = state.clone();
        Ok(Box::new(move || Ok(Box::new(run(&mut state.borrow_mut())?) as PassResult)))
    })
}

/// A pass to time, a line of the table.
pub struct Pass {
    pub kind: PassKind,
    pub prepare: Prepare,
}

/// Times of several runs.
#[derive(Clone, Copy, Debug)]
pub struct RunTimes {
    pub median_s: f64,
    pub runs: usize,
    /// Share of the processors' time that this program used during timed runs, at most 1. NaN if the system does not report
    /// it, and unreliable below a tenth of a second, because the system counts hundredths of a second.
    pub busy: f64,
    /// Kernels of this project that one run launched, and the bytes of all buffers that they were given; 0 on a CPU.
    pub launches: u64,
    pub bound_bytes: u64,
}

/// Largest number of runs. More runs would not change a median noticeably.
const RUNS: usize = 31;

/// Number of warm-up runs: the first compiles the kernels, and the second finds every buffer in the pool.
const WARM_UP: usize = 2;

/// Runs all passes in turns until the budget, which includes preparations, is spent, each at least once after the warm-up.
/// The turns spread other load of the machine evenly over the passes.
pub fn time<'a>(
    all: impl IntoIterator<Item = &'a mut Prepare>,
    device: &Device,
    budget: Duration,
) -> Result<Vec<RunTimes>, Box<dyn Error>> {
    let mut all: Vec<(&mut Prepare, Vec<TimedRun>)> = all.into_iter().map(|prepare| (prepare, Vec::new())).collect();
    let begin = Instant::now();
    for round in 0..WARM_UP + RUNS {
        // On a slow device the second warm-up would take most of the budget.
        let warm = round == 0 || round < WARM_UP && begin.elapsed() < budget / 4;
        for (prepare, runs) in &mut all {
            let run = run(prepare, device)?;
            if !warm {
                runs.push(run);
            }
        }
        if !warm && begin.elapsed() > budget {
            break;
        }
    }
    Ok(all.into_iter().map(|(_, runs)| summary(&runs)).collect())
}

struct TimedRun {
    elapsed_s: f64,
    /// Processor time over all processors.
    used_s: f64,
    launches: u64,
    bound_bytes: u64,
}

fn run(prepare: &mut Prepare, device: &Device) -> Result<TimedRun, Box<dyn Error>> {
    let timed = prepare()?;
    device.sync()?;
    let (launches, bound_bytes) = (dispatches(), test_hooks::bound_bytes());
    let before = processor_time();
    let start = Instant::now();
    let kept = timed()?;
    device.sync()?;
    let (elapsed_s, used_s) = (start.elapsed().as_secs_f64(), processor_time() - before);
    drop(kept);
    let (launches, bound_bytes) = (dispatches() - launches, test_hooks::bound_bytes() - bound_bytes);
    Ok(TimedRun { elapsed_s, used_s, launches, bound_bytes })
}

fn summary(runs: &[TimedRun]) -> RunTimes {
    let mut seconds: Vec<f64> = runs.iter().map(|run| run.elapsed_s).collect();
    let there = seconds.iter().sum::<f64>() * rayon::current_num_threads() as f64;
    seconds.sort_by(f64::total_cmp);
    let used: f64 = runs.iter().map(|run| run.used_s).sum();
    let (launches, bound_bytes) = runs.last().map_or((0, 0), |run| (run.launches, run.bound_bytes));
    let (median_s, runs) = (seconds[seconds.len() / 2], seconds.len());
    RunTimes { median_s, runs, busy: used / there, launches, bound_bytes }
}

/// Returns the processor time of this program so far, on all threads, in seconds with a resolution of hundredths; NaN without
/// `/proc`.
fn processor_time() -> f64 {
    // Linux counts in hundredths of a second on every machine.
    const TICKS_PER_S: f64 = 100.0;
    let read = || {
        let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
        // The second field, the program's name, may contain any character and ends at the last parenthesis.
        let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
        let mut ticks = || fields.next()?.parse::<f64>().ok();
        Some((ticks()? + ticks()?) / TICKS_PER_S)
    };
    read().unwrap_or(f64::NAN)
}

/// Times all passes in turns, prints a line for each and returns the times. `base` holds the medians of the device that
/// the times are compared with.
pub fn table(
    passes: &mut [Pass],
    device: &Device,
    machine: &Machine,
    sizes: &Sizes,
    budget: Duration,
    base: &[f64],
) -> Result<Vec<RunTimes>, Box<dyn Error>> {
    let all = time(passes.iter_mut().map(|pass| &mut pass.prepare), device, budget)?;
    println!(
        "  {:<21}{:>10}{:>6}{:>10}{:>9}{:>11}{:>11}{:>10}{:>11}{:>9}",
        "pass",
        "median ms",
        "runs",
        "limit ms",
        "× limit",
        "least MiB",
        "least Mop",
        "launches",
        "bound MiB",
        "× first"
    );
    for (i, (pass, times)) in passes.iter().zip(&all).enumerate() {
        let (work, limit) = (sizes.work(pass.kind), sizes.limit(pass.kind, machine));
        let ratio = base.get(i).map_or("-".into(), |first| format!("{:.2}", times.median_s / first));
        println!(
            "  {:<21}{:>10.2}{:>6}{:>10.3}{:>9.1}{:>11.1}{:>11.1}{:>10}{:>11.1}{ratio:>9}",
            pass.kind.name(),
            1e3 * times.median_s,
            times.runs,
            1e3 * limit,
            times.median_s / limit,
            work.bytes / f64::from(1 << 20),
            work.operations / 1e6,
            times.launches,
            times.bound_bytes as f64 / f64::from(1 << 20),
        );
    }
    Ok(all)
}

/// Measures the bytes per second, read and written, of adding a number to 64 MiB on a device.
pub fn copy_bandwidth(device: &Device) -> Result<f64, Box<dyn Error>> {
    const ELEMENTS: usize = 16 << 20;
    let source = Tensor::<1>::ones([ELEMENTS], device);
    let mut copy: Prepare = Box::new(move || {
        let source = source.clone();
        Ok(Box::new(move || Ok(Box::new(source + 1.0) as PassResult)))
    });
    let times = time([&mut copy], device, Duration::from_secs(5))?;
    Ok((2 * size_of::<f32>() * ELEMENTS) as f64 / times[0].median_s)
}
