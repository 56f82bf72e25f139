//! Times with the device waited for, and what they mean in bytes per second.

use std::any::Any;
use std::error::Error;
use std::time::{Duration, Instant};

use burn::tensor::{Device, Tensor};

/// What a pass leaves behind, freed outside the timed part.
pub type Kept = Box<dyn Any>;

/// The timed part of a run. Errors are those of the op.
pub type Timed = Box<dyn FnOnce() -> Result<Kept, Box<dyn Error>>>;

/// One line of the table.
pub struct Pass {
    pub name: &'static str,
    /// What it moves at least: each input read once, each output written once.
    pub bytes: usize,
    /// Prepares a run, untimed, and gives the timed part.
    pub prepare: Box<dyn FnMut() -> Result<Timed, Box<dyn Error>>>,
}

/// Times of several runs.
pub struct Times {
    pub median_s: f64,
    pub runs: usize,
}

/// Runs after which more would change no median that is worth reading.
const RUNS: usize = 31;

/// Runs that are not counted: the first compiles the kernels, the second finds every buffer in the pool.
const WARM_UP: usize = 2;

impl Pass {
    /// Runs until the budget, which preparations share, is spent; at least once after the warm-up.
    pub fn time(&mut self, device: &Device, budget: Duration) -> Result<Times, Box<dyn Error>> {
        let mut seconds = Vec::with_capacity(RUNS);
        let begin = Instant::now();
        let mut run = 0;
        while seconds.len() < RUNS {
            // On a slow device the second warm-up would be most of the budget.
            let warm = run == 0 || run < WARM_UP && begin.elapsed() < budget / 4;
            let timed = (self.prepare)()?;
            device.sync()?;
            let start = Instant::now();
            let kept = timed()?;
            device.sync()?;
            let elapsed = start.elapsed().as_secs_f64();
            drop(kept);
            run += 1;
            if !warm {
                seconds.push(elapsed);
                if begin.elapsed() > budget {
                    break;
                }
            }
        }
        seconds.sort_by(f64::total_cmp);
        Ok(Times { median_s: seconds[seconds.len() / 2], runs: seconds.len() })
    }
}

/// Bytes per second of adding a number to 64 MiB, read and written.
pub fn copy_bandwidth(device: &Device) -> Result<f64, Box<dyn Error>> {
    const ELEMENTS: usize = 16 << 20;
    let source = Tensor::<1>::ones([ELEMENTS], device);
    let mut copy = Pass {
        name: "copy",
        bytes: 2 * size_of::<f32>() * ELEMENTS,
        prepare: Box::new(move || {
            let source = source.clone();
            Ok(Box::new(move || Ok(Box::new(source + 1.0) as Kept)))
        }),
    };
    let times = copy.time(device, Duration::from_secs(5))?;
    Ok(copy.bytes as f64 / times.median_s)
}
