//! The part of every rank but the first: it prepares the same run, takes the steps that rank 0 orders, and writes nothing.

use std::rc::Rc;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use splat_model::trainer::ranks::Ranks;
use splat_model::trainer::{TrainError, Trainer};

use super::{Order, RunSetup, tell};
use crate::effects::ChosenEffects;
use crate::input;
use crate::progress::VoiceArgs;
use crate::stop::Stop;
use crate::train::checkpoints;
use crate::train::job::Job;

/// Takes part in the run of rank 0, to its end.
pub(crate) fn follow(ranks: &Rc<dyn Ranks>) -> Result<()> {
    VoiceArgs { quiet: true, json: false }.apply();
    match steps(ranks) {
        // All ranks have this error. Rank 0 prints it, saves what can be saved, and then ends all.
        Err(error)
            if error.downcast_ref::<TrainError>().is_some_and(|error| !matches!(error, TrainError::Ranks(_))) =>
        {
            ranks.gather(&[])?;
            Err(error)
        }
        ended => ended,
    }
}

fn steps(ranks: &Rc<dyn Ranks>) -> Result<()> {
    let Some(setup) = tell::<Option<RunSetup>>(&**ranks, None)?.flatten() else { return Ok(()) };
    let mut trainer = prepare(ranks, setup)?;
    // Rank 0 decides when to stop: `mpirun` and `srun` signal all ranks.
    let _stop = Stop::listen().context("cannot listen for Ctrl-C")?;
    loop {
        match tell::<Order>(&**ranks, None)? {
            None | Some(Order::End) => return Ok(()),
            Some(Order::Step(config)) => {
                if let Some(config) = config {
                    trainer.reschedule(&config)?;
                }
                trainer.step()?;
            }
        }
    }
}

fn prepare(ranks: &Rc<dyn Ranks>, setup: RunSetup) -> Result<Trainer> {
    let RunSetup { args, config, effects, checkpoint } = setup;
    let (device, _) = args.device.resolve()?;
    let folder = args.capture.as_ref().ok_or_else(|| anyhow!("rank 0 named no capture"))?;
    let capture = input::capture(folder)?;
    let (split, _) = args.photos.split(&capture);
    let seen = split.require_train()?;
    super::agree_on_files(&**ranks, &capture, seen)?;
    let effects = ChosenEffects::named(&effects)?;
    let job = Job { args, config, capture: Arc::new(capture), effects, device };
    let (train, _) = job.photographs(seen, &[], &**ranks)?;
    let mut trainer = job.trainer(train, checkpoint.is_none(), ranks)?;
    if let Some(path) = checkpoint {
        let saved = checkpoints::read(&path).with_context(|| format!("cannot resume from {}", path.display()))?;
        trainer.resume(saved.trainer)?;
    }
    Ok(trainer)
}
