//! The steps of a run, and the work between them: taking scores, writing checkpoints, and stopping on request.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use splat_model::trainer::ranks::Ranks;
use splat_model::trainer::{TrainConfig, Trainer};

use super::TrainArgs;
use super::checkpoints::SoFar;
use super::job::Job;
use super::results::{self, Done, export, keep_scene};
use super::run::Run;
use super::setup::Setup;
use super::time_limit::{TimeLimit, set_steps};
use crate::live::Live;
use crate::ranks::{self, Order};
use crate::report::{Metrics, RunLog};
use crate::stop::{Interrupted, Stop};

/// Longest time between checkpoints.
const BETWEEN_CHECKPOINTS: Duration = Duration::from_secs(120);

/// Number of scores that are taken without being asked for, if they take at most this share of the training time.
const SCORES: usize = 10;
const SCORING_SHARE: f64 = 0.02;

/// Whether a checkpoint is due after a step, and `since` the last one. `every` is `--checkpoint-every`.
fn is_checkpoint_due(every: Option<usize>, step: usize, since: Duration) -> bool {
    match every {
        Some(0) => false,
        every => since >= BETWEEN_CHECKPOINTS || every.is_some_and(|every| step.is_multiple_of(every)),
    }
}

/// Whether scores are due at the trainer's step. `every` is `--eval-during`.
fn is_score_due(every: Option<usize>, trainer: &Trainer, scoring_s: f64, training_s: f64) -> bool {
    let (step, steps) = (trainer.steps_done(), trainer.config().steps);
    match every {
        Some(every) => every > 0 && step.is_multiple_of(every),
        None => scores_by_itself(step, steps, scoring_s, training_s),
    }
}

/// Whether a run that was not told when takes scores at a step: at each tenth of the steps at which the time of all scores so far and of
/// this one, `scoring_s`, is at most a share of the time that the steps have taken, `training_s`.
fn scores_by_itself(step: usize, steps: usize, scoring_s: f64, training_s: f64) -> bool {
    let is_turn = step * SCORES / steps > (step - 1) * SCORES / steps;
    is_turn && scoring_s <= SCORING_SHARE * training_s
}

impl Run {
    /// Runs all remaining steps and writes the results. An error if a step fails or a result cannot be written;
    /// [`Interrupted`] if the run was asked to stop.
    pub fn finish(self) -> Result<Metrics> {
        let Self { setup, mut trainer, test, mut checkpoints, so_far, server, ranks, load_s } = self;
        let Setup { job: Job { args, capture, device, .. }, out, lpips, .. } = &setup;
        let mut live = server.map(|server| Live::start(server, &trainer, &test, device, out.path())).transpose()?;
        let stop = Stop::listen().context("cannot listen for Ctrl-C")?;
        let mut time_limit = args.time.map(TimeLimit::new);
        let schedule = |config, steps| args.schedule(config, steps);
        // The first checkpoint comes before the first step: a run killed at once can be resumed too, and an unwritable folder is found now.
        if trainer.steps_done() == 0 && args.checkpoint_every != Some(0) {
            checkpoints.write(&mut trainer, args, &so_far)?;
        }
        let mut written = Instant::now();
        let mut log = RunLog::new(&trainer, so_far.history, so_far.seconds);
        let mut stopped_at = None;
        let mut told = trainer.config().clone();
        while !trainer.is_done() {
            if let Some(signal) = stop.asked() {
                let so_far = so_far_of(&trainer, args, &log);
                log.finish();
                let step = trainer.steps_done();
                let saved = checkpoints.write(&mut trainer, args, &so_far);
                let path = saved.with_context(|| format!("stopped after step {step}, which could not be saved"))?;
                order(&*ranks, Order::End)?;
                let (out, path) = (out.path().display(), path.display());
                let message = format!("stopped after step {step}; `splat resume {out}` continues from {path}");
                return Err(Interrupted { signal, message }.into());
            }
            order_step(&*ranks, &trainer, &mut told)?;
            let mut evaluated = Ok(());
            let step = trainer.step_and_look(|trainer| {
                let scoring_s = if test.is_empty() { f64::INFINITY } else { log.scoring_s_with_next(&test) };
                if is_score_due(args.eval_during, trainer, scoring_s, log.recorder.elapsed_s()) {
                    evaluated = log.evaluate(trainer, &test, device, lpips.as_ref());
                }
            });
            match step {
                Ok(report) => log.step(&report, &trainer),
                Err(error) => {
                    log.finish();
                    return Err(keep_scene(error, &trainer, capture, out));
                }
            }
            evaluated?;
            if let Some(live) = &mut live {
                live.step(&trainer, &mut log)?;
            }
            if stopped_at.is_none() && !trainer.is_done() && live.as_ref().is_some_and(Live::stops) {
                stopped_at = Some(trainer.steps_done());
                time_limit = None;
                let so_far = so_far_of(&trainer, args, &log);
                checkpoints.write(&mut trainer, args, &so_far)?;
                // One more step, which waits for the device and finds its faults.
                set_steps(trainer.steps_done() + 1, &mut trainer, &schedule, &mut log)?;
            }
            if let Some(limit) = &mut time_limit {
                limit.adjust(&mut trainer, &schedule, &mut log)?;
            }
            if args.export_every.is_some_and(|every| trainer.steps_done().is_multiple_of(every)) {
                export(&trainer, capture, out);
            }
            if is_checkpoint_due(args.checkpoint_every, trainer.steps_done(), written.elapsed()) {
                written = Instant::now();
                let so_far = so_far_of(&trainer, args, &log);
                checkpoints.try_write(&mut trainer, args, &so_far);
            }
        }
        order(&*ranks, Order::End)?;
        // From here on, a signal ends the process at once.
        drop(stop);
        let (seconds, scoring_s) = (log.recorder.seconds(), log.scoring_s());
        let done = Done { seconds, scoring_s, history: log.finish(), checkpoints, live, stopped_at };
        results::write(&setup, trainer, &test, load_s, done)
    }
}

/// Orders a step of the other ranks, with the configuration if it is no longer the one that they were `told`.
fn order_step(ranks: &dyn Ranks, trainer: &Trainer, told: &mut TrainConfig) -> Result<()> {
    if ranks.count() == 1 {
        return Ok(());
    }
    let changed = trainer.config() != told;
    if changed {
        told.clone_from(trainer.config());
    }
    order(ranks, Order::Step(changed.then(|| Box::new(told.clone()))))
}

fn order(ranks: &dyn Ranks, order: Order) -> Result<()> {
    if ranks.count() > 1 {
        ranks::tell(ranks, Some(order))?;
    }
    Ok(())
}

/// Returns the progress of the run besides its trainer.
fn so_far_of(trainer: &Trainer, args: &TrainArgs, log: &RunLog) -> SoFar {
    let steps = args.time.map(|_| trainer.config().steps);
    SoFar { seconds: log.recorder.seconds(), steps, history: log.recorder.history.clone() }
}

#[cfg(test)]
mod tests;
