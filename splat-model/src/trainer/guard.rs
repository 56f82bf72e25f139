//! No step with a loss or a gradient that is not finite changes the scene.
//!
//! On a CPU every step is looked at before it is taken. On a GPU looking would wait for the device at each step; there the
//! verdict stays on the device, where it holds back this step and all that follow, and is read from time to time: whenever
//! the number of Gaussians is about to change, which reads the scene anyway, and every [`READ_EVERY`] steps. The error then
//! comes some steps late, names the step it is about, and the scene is still that before the step.

use burn::tensor::{Bool, Device, Tensor};
use splat_op::activate::non_finite;

use crate::density::rows::Gradients;
use crate::gaussians::values_of;

/// Steps between readings of the verdict on a GPU: one wait in fifty steps is not to be measured.
const READ_EVERY: usize = 50;

/// What is looked at, in the order in which it is computed.
const WATCHED: [&str; 7] = ["loss", "means", "rotations", "log_scales", "logit_opacities", "sh_dc", "sh_rest"];

/// A step that was not taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Fault {
    /// Counted from 1.
    pub step: usize,
    /// Number of the photograph.
    pub view: usize,
    /// "the loss", or which gradients, in words.
    pub what: String,
}

/// Looks at every step.
pub(super) struct Guard {
    /// Whether results have to be waited for.
    waits: bool,
    /// `[7]`, on a device that has to be waited for: for each of [`WATCHED`] the first step at which it was not finite, 0 if
    /// there was none. Once one is set the others stay.
    verdict: Option<Tensor<1>>,
    /// Steps and their photographs since the verdict was last read.
    unread: Vec<(usize, usize)>,
}

impl Guard {
    /// For a run on `device`.
    pub fn new(device: &Device) -> Self {
        Self { waits: splat_op::is_gpu(device), verdict: None, unread: Vec::new() }
    }

    /// Looks at the loss, `[1]`, and the gradients of a step before it is taken. Where the answer is not waited for, it is
    /// returned: `[1]`, whether this step must change nothing.
    ///
    /// # Errors
    /// What is not finite, if that is known.
    pub fn look(
        &mut self,
        step: usize,
        view: usize,
        loss: &Tensor<1>,
        gradients: &Gradients,
    ) -> Result<Option<Tensor<1, Bool>>, Fault> {
        let Gradients { means, rotations, log_scales, logit_opacities, sh_dc, sh_rest } = gradients;
        let flags = [
            Some(non_finite(loss)),
            means.as_ref().map(non_finite),
            rotations.as_ref().map(non_finite),
            log_scales.as_ref().map(non_finite),
            logit_opacities.as_ref().map(non_finite),
            sh_dc.as_ref().map(non_finite),
            sh_rest.as_ref().map(non_finite),
        ];
        if !self.waits {
            let bad = flags.map(|flag| flag.is_some_and(|flag| flag.into_scalar::<i32>() != 0));
            return if bad.contains(&true) { Err(Fault { step, view, what: in_words(bad) }) } else { Ok(None) };
        }
        let none = || Tensor::zeros([1], &loss.device().inner());
        let flags = flags.into_iter().map(|flag| flag.map_or_else(none, |flag| flag.float())).collect();
        let now = Tensor::cat(flags, 0) * step as f64;
        // The first fault stays: what comes after it is its consequence or the same again.
        let verdict = match self.verdict.take() {
            None => now,
            Some(before) => {
                let sound = before.clone().max().equal_elem(0.0).expand([WATCHED.len()]);
                before.mask_where(sound, now)
            }
        };
        let bad = verdict.clone().max().greater_elem(0.0);
        self.verdict = Some(verdict);
        self.unread.push((step, view));
        Ok(Some(bad))
    }

    /// Reads the verdict if `now`, or if it has not been read for long.
    ///
    /// # Errors
    /// The first step that was not finite.
    pub fn read(&mut self, now: bool) -> Result<(), Fault> {
        if self.unread.is_empty() || !(now || self.unread.len() >= READ_EVERY) {
            return Ok(());
        }
        let unread = std::mem::take(&mut self.unread);
        let Some(verdict) = &self.verdict else { return Ok(()) };
        let steps = values_of(verdict.clone());
        let first = steps.iter().fold(0.0, |first: f32, step| first.max(*step)) as usize;
        match unread.iter().find(|(step, _)| *step == first) {
            None => Ok(()),
            Some(&(step, view)) => {
                let bad = std::array::from_fn(|i| steps[i] > 0.0);
                Err(Fault { step, view, what: in_words(bad) })
            }
        }
    }
}

/// The loss explains its gradients; else they are listed.
fn in_words(bad: [bool; WATCHED.len()]) -> String {
    if bad[0] {
        return "the loss".into();
    }
    let names: Vec<String> =
        WATCHED.iter().zip(bad).filter(|(_, bad)| *bad).map(|(name, _)| format!("`{name}`")).collect();
    format!("the gradient of {}", names.join(", "))
}

#[cfg(test)]
mod tests;
