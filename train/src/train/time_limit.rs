//! `--for`: as many steps as fit a time.
//!
//! A run with a time limit begins with a guessed number of steps. From a hundredth of its time on, the number is chosen again
//! and again such that the predicted time of the remaining steps is the time that is left. Learning rates, growth and all other
//! schedules follow the number, so that the run ends as one that had it from the start.

use splat_model::trainer::{TrainConfig, TrainError, Trainer};

use crate::report::log::RunLog;

/// Number of steps before any is measured.
pub const GUESS: usize = 2_000;

/// Share of the time after which the number of steps is first chosen.
const FIRST: f64 = 0.01;

/// Largest share of the time between two choices. The share doubles until then.
const BETWEEN: f64 = 0.03;

/// Power of the ratio of times by which a choice changes the number of steps. The time grows faster than the number, because a
/// longer run has more Gaussians; with a power of 1, choices would go back and forth.
const DAMPING: f64 = 0.7;

/// Largest number of changes in one choice.
const CHANGES: usize = 8;

/// A change of the number of remaining steps by less than this share ends a choice.
const SETTLED: f64 = 0.005;

/// Range of one change.
const CHANGE: (f64, f64) = (0.1, 10.0);

/// Parses a time for training: `60s`, `10min`, `1h 30m`.
pub fn parse_time(text: &str) -> Result<humantime::Duration, String> {
    let expected = "expected a time above zero, such as 60s, 10min or '1h 30m'";
    let time: humantime::Duration = text.parse().map_err(|error| format!("{error}: {expected}"))?;
    if time.is_zero() { Err(expected.into()) } else { Ok(time) }
}

/// Returns the configuration with the schedules of a run of so many steps.
pub type Schedule<'a> = &'a dyn Fn(TrainConfig, usize) -> TrainConfig;

/// The choices of a run's number of steps.
pub struct TimeLimit {
    /// Training time of the whole run, s.
    seconds: f64,
    /// Share of the time at which the next choice is due.
    next: f64,
}

impl TimeLimit {
    pub fn new(time: humantime::Duration) -> Self {
        Self { seconds: time.as_secs_f64(), next: FIRST }
    }

    /// Chooses the number of steps after a step, if it is time to. One more step at least remains, which waits for the device
    /// and finds its faults.
    pub fn adjust(&mut self, trainer: &mut Trainer, schedule: Schedule, log: &mut RunLog) -> Result<(), TrainError> {
        let remaining = self.seconds - log.recorder.elapsed_s();
        let share = 1.0 - remaining / self.seconds;
        if share < self.next || trainer.is_done() {
            return Ok(());
        }
        if remaining <= 0.0 {
            self.next = f64::INFINITY;
            return set_steps(trainer.steps_done() + 1, trainer, schedule, log);
        }
        self.next = share + share.min(BETWEEN);
        for _ in 0..CHANGES {
            let (step, steps) = (trainer.steps_done(), trainer.config().steps);
            let left = log.left_s();
            if !(left > 0.0 && left.is_finite()) {
                break;
            }
            let change = (remaining / left).powf(DAMPING).clamp(CHANGE.0, CHANGE.1);
            let more = ((steps - step) as f64 * change).round().max(1.0) as usize;
            set_steps(step + more, trainer, schedule, log)?;
            if (change - 1.0).abs() < SETTLED {
                break;
            }
        }
        Ok(())
    }
}

pub fn set_steps(steps: usize, trainer: &mut Trainer, schedule: Schedule, log: &mut RunLog) -> Result<(), TrainError> {
    trainer.reschedule(&schedule(trainer.config().clone(), steps))?;
    log.reschedule(trainer);
    Ok(())
}

#[cfg(test)]
mod tests;
