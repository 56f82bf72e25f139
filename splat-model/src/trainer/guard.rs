//! No step with a loss or a gradient that is not finite changes the scene.
//!
//! On a CPU every step is looked at before it is taken. On a GPU looking would wait for the device at each step; there the
//! verdict stays on the device, where it holds back this step and all that follow, and is read from time to time: whenever
//! the number of Gaussians is about to change, which reads the scene anyway, and every [`READ_EVERY`] steps. The error then
//! comes some steps late, names the step it is about, and the scene is still that before the step.

use burn::tensor::{DType, Device, Int, Tensor};
use splat_op::activate::non_finite;
use splat_op::adam::{VERDICT, watch};

use crate::density::rows::Gradients;

/// Steps between readings of the verdict on a GPU: one wait in fifty steps is not to be measured.
const READ_EVERY: usize = 50;

/// What is looked at, in the order in which it is computed.
const WATCHED: [&str; 6] = ["loss", "means", "rotations", "log_scales", "logit_opacities", "sh"];

/// A step that was not taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Counted from 1.
    pub step: usize,
    /// Number of the photograph.
    pub view: usize,
    /// "the loss", or which gradients, in words.
    pub what: String,
}

/// Looks at every step; the trainer's, and for training loops of your own.
pub struct Guard {
    /// Whether results have to be waited for.
    waits: bool,
    /// `[2]`, on a device that has to be waited for, see [`splat_op::adam`]: the first step that was not finite, 0 if there was
    /// none, and which of [`WATCHED`] it was.
    verdict: Option<Tensor<1, Int>>,
    /// Steps and their photographs since the verdict was last read.
    unread: Vec<(usize, usize)>,
}

impl Guard {
    /// For a run on `device`.
    pub fn new(device: &Device) -> Self {
        Self { waits: splat_op::is_gpu(device), verdict: None, unread: Vec::new() }
    }

    /// Looks at the loss, `[1]`, and the gradients of a step, counted from 1, on photograph number `view`, before it is taken.
    /// Where the answer is not waited for, it is
    /// returned: a verdict, `[2]`. This step must change nothing if one is entered in it.
    ///
    /// # Errors
    /// What is not finite, if that is known.
    pub fn look(
        &mut self,
        step: usize,
        view: usize,
        loss: &Tensor<1>,
        gradients: &Gradients,
    ) -> Result<Option<Tensor<1, Int>>, Fault> {
        let Gradients { means, rotations, log_scales, logit_opacities, sh } = gradients;
        if !self.waits {
            let flags = [
                Some(non_finite(loss)),
                means.as_ref().map(non_finite),
                rotations.as_ref().map(non_finite),
                log_scales.as_ref().map(non_finite),
                logit_opacities.as_ref().map(non_finite),
                sh.as_ref().map(non_finite),
            ];
            let bad = flags.map(|flag| flag.is_some_and(|flag| flag.into_scalar::<i32>() != 0));
            return if bad.contains(&true) { Err(Fault { step, view, what: in_words(bad) }) } else { Ok(None) };
        }
        let none = || Tensor::zeros([VERDICT], (&loss.device().inner(), DType::I32));
        let mut look = Look { verdict: self.verdict.take().unwrap_or_else(none), step };
        look.at(0, Some(loss));
        look.at(1, means.as_ref());
        look.at(2, rotations.as_ref());
        look.at(3, log_scales.as_ref());
        look.at(4, logit_opacities.as_ref());
        look.at(5, sh.as_ref());
        self.verdict = Some(look.verdict.clone());
        self.unread.push((step, view));
        Ok(Some(look.verdict))
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
        let numbers: Vec<i32> = verdict.clone().into_data().iter().collect();
        let [first, which] = [0, 1].map(|i| numbers[i] as usize);
        match unread.iter().find(|(step, _)| *step == first) {
            None => Ok(()),
            Some(&(step, view)) => {
                let bad = std::array::from_fn(|i| which >> i & 1 != 0);
                Err(Fault { step, view, what: in_words(bad) })
            }
        }
    }
}

/// A verdict in the making.
struct Look {
    verdict: Tensor<1, Int>,
    step: usize,
}

impl Look {
    /// Looks at number `i` of [`WATCHED`].
    fn at<const D: usize>(&mut self, i: u32, values: Option<&Tensor<D>>) {
        let Some(values) = values else { return };
        let step = self.step as i32;
        self.verdict.inplace(|verdict| {
            // Where there is no operation for it, the same in tensor code.
            watch(values, verdict, step as u32, i).unwrap_or_else(|verdict| {
                let first = verdict.clone().narrow(0, 0, 1);
                let open = first.clone().equal_elem(0).int() + first.clone().equal_elem(step).int();
                let bad = non_finite(&values.clone().inner()) * open;
                let entered = first.clone() + bad.clone() * (first.neg() + step);
                Tensor::cat(vec![entered, verdict.narrow(0, 1, 1) + bad * (1 << i)], 0)
            })
        });
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
