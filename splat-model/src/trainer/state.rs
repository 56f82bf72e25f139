//! Saving and resuming of runs.

use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use super::{Result, TrainConfig, TrainError, Trainer};
use crate::density::rows::Trained;
use crate::effects::Effect;
use crate::gaussians::{BASE_GROUPS, Group};
use crate::state::{State, StateError};

impl Trainer {
    /// Saves the state that the run needs to resume: parameters and their moments, learned parameters of effects,
    /// statistics of density control, random number generators, and what a custom loss saves. Photographs are not included.
    ///
    /// # Errors
    /// If an earlier step turns out to have failed.
    pub fn save(&mut self) -> Result<State> {
        self.guard.read(true).map_err(|fault| self.non_finite(fault))?;
        let mut state = State::default();
        state.tell("step", &self.step)?;
        state.tell("config", &self.config)?;
        state.tell("photographs", &self.photographs())?;
        state.tell("queue", &self.queue)?;
        state.tell("random", &self.rng)?;
        state.put_part("scene", self.scene.save()?);
        state.in_part("density", |part| self.density.save(part))?;
        state.in_part("effects", |part| self.effects.save(part))?;
        state.in_part("loss", |part| self.loss.save(part))?;
        Ok(state)
    }

    /// Resumes from a saved state. On a CPU the continuation is equal to the uninterrupted run, bit for bit.
    ///
    /// # Errors
    /// If the state belongs to a run with other options or photographs, or is incomplete. This run is then unusable.
    pub fn resume(&mut self, mut state: State) -> Result<()> {
        let config: TrainConfig = state.told("config")?;
        check_same(&config, &self.config)?;
        let photographs: Vec<(String, [usize; 2])> = state.told("photographs")?;
        let own = self.photographs();
        if let Some(i) = (0..photographs.len().max(own.len())).find(|&i| photographs.get(i) != own.get(i)) {
            let shown = |found: Option<&(String, [usize; 2])>| match found {
                Some((name, [width, height])) => format!("{name} ({width} x {height})"),
                None => "none".into(),
            };
            let (found, expected) = (shown(own.get(i)), shown(photographs.get(i)));
            return Err(TrainError::OtherRun { what: format!("photograph {}", i + 1), found, expected });
        }
        let step = state.told("step")?;
        let queue: Vec<usize> = state.told("queue")?;
        if let Some(view) = queue.iter().find(|view| **view >= own.len()) {
            let (found, expected) = (view.to_string(), format!("below {}", own.len()));
            return Err(TrainError::OtherRun { what: "a photograph in the queue".into(), found, expected });
        }
        let rng: ChaCha8Rng = state.told("random")?;
        let scene = state
            .load_part("scene", |part| Trained::load(part, config.moment_bits, &self.device.clone().autodiff()))?;
        // A group that only the state has came with a scene that the run started from, and is not trained.
        let [own, kept] = [&self.scene, &scene].map(|scene| &scene.gaussians.groups()[BASE_GROUPS.len()..]);
        let is_own = |group: &&Group| own.iter().any(|own| own.name() == group.name()) || group.options().rate != 0.0;
        let (found, expected) = (groups_of(own.iter()), groups_of(kept.iter().filter(is_own)));
        if found != expected {
            return Err(TrainError::OtherRun { what: "the list of further groups".into(), found, expected });
        }
        self.scene = scene;
        state.load_part("density", |part| self.density.load(part, &self.device))?;
        state.load_part("effects", |part| self.effects.load(part, &self.device))?;
        state.load_part("loss", |part| self.loss.load(part, &self.device))?;
        state.finish()?;
        (self.queue, self.rng, self.step) = (queue, rng, step);
        Ok(())
    }

    fn photographs(&self) -> Vec<(String, [usize; 2])> {
        (0..self.views.len()).map(|view| (self.views.name(view).to_owned(), self.views.full_size(view))).collect()
    }
}

/// Groups in words, by name.
fn groups_of<'a>(groups: impl Iterator<Item = &'a Group>) -> String {
    let of = |group: &Group| format!("{} [{}] {:?}", group.name(), group.width(), group.options());
    let mut words: Vec<String> = groups.map(of).collect();
    words.sort();
    if words.is_empty() { "none".into() } else { words.join(", ") }
}

/// Returns an error for the first option that differs between the saved run and this one.
fn check_same(kept: &TrainConfig, own: &TrainConfig) -> Result<()> {
    let fields =
        |config: &TrainConfig| serde_json::to_value(config).map_err(|reason| StateError::fact("config", &reason));
    let (kept, own) = (fields(kept)?, fields(own)?);
    let (Value::Object(kept), Value::Object(own)) = (kept, own) else { return Ok(()) };
    let differing = kept.iter().find(|(name, value)| own.get(*name) != Some(value));
    let Some((name, expected)) = differing else { return Ok(()) };
    let (what, found) = (format!("the option `{name}`"), own.get(name).map(Value::to_string).unwrap_or_default());
    Err(TrainError::OtherRun { what, found, expected: expected.to_string() })
}

#[cfg(test)]
mod tests;
