//! Protects the scene from steps whose loss or gradients are not finite.
//!
//! On a CPU every step is checked before it is taken. On a GPU a check would wait for the device at each step, so the
//! verdict stays on the device, where it blocks the failed step and all later steps. It is read whenever the number of
//! Gaussians is about to change, which reads the scene anyway, and every [`READ_EVERY`] steps. The error then comes some
//! steps late and names the failed step. The scene still has its state before that step.

use burn::tensor::{DType, Device, Int, Tensor};
use splat_op::activate::non_finite;
use splat_op::adam::{LAST_BIT, VERDICT, has_kernel, watch};
use splat_op::read_back;

use crate::density::rows::Gradients;

/// Steps between readings of the verdict on a GPU. The cost of one wait in fifty steps is not measurable.
const READ_EVERY: usize = 50;

/// A step that was blocked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Number of the step, counted from 1.
    pub step: usize,
    /// Index of the photograph.
    pub view: usize,
    /// "the loss", or the names of the parameters with non-finite gradients.
    pub what: String,
}

/// Checks every step. Used by the trainer and available to custom training loops. The default one checks each step before it is taken,
/// on any device: on a GPU it waits for the device in every step.
#[derive(Default)]
pub struct Guard {
    /// Whether the device computes asynchronously.
    waits: bool,
    /// `[2]`, on an asynchronous device (see [`splat_op::adam`]): the first step with a non-finite value, 0 for none, and a bit for
    /// the loss and for each gradient.
    verdict: Option<Tensor<1, Int>>,
    /// Names of the gradients at the last step, block by block. Rows, and so blocks, change only after a reading.
    names: Vec<String>,
    /// Steps and their photographs since the last reading of the verdict.
    unread: Vec<(usize, usize)>,
}

impl Guard {
    /// A guard for a run on `device`.
    pub fn new(device: &Device) -> Self {
        Self { waits: splat_op::is_gpu(device), ..Self::default() }
    }

    /// Checks the loss, `[1]`, and the gradients of a step, counted from 1, on photograph number `view`, before the step is taken. On an
    /// asynchronous device it returns a verdict, `[2]`. The step must change nothing if a step is recorded in the verdict.
    ///
    /// # Errors
    /// The non-finite values, if they are known yet.
    pub fn look(
        &mut self,
        step: usize,
        view: usize,
        loss: &Tensor<1>,
        gradients: &Gradients,
    ) -> Result<Option<Tensor<1, Int>>, Fault> {
        let gradients: Vec<_> = gradients.blocks().collect();
        if self.waits {
            let none = || Tensor::zeros([VERDICT], (&loss.device().inner(), DType::I32));
            let verdict = self.verdict.take().unwrap_or_else(none);
            let verdict = match has_kernel(loss) {
                true => {
                    let values: Vec<_> = gradients.iter().map(|(_, values)| *values).collect();
                    watch(loss, &values, verdict, step as u32)
                }
                false => entered(verdict, flags(loss, &gradients), step),
            };
            self.names = gradients.iter().map(|(name, _)| (*name).to_owned()).collect();
            self.verdict = Some(verdict.clone());
            self.unread.push((step, view));
            return Ok(Some(verdict));
        }
        let (watched, flags): (Vec<usize>, Vec<Tensor<1, Int>>) = flags(loss, &gradients).into_iter().unzip();
        // One reading for all: each costs more than the check of a small parameter.
        let flags: Vec<i32> = read_back(Tensor::cat(flags, 0)).iter().collect();
        let bad: Vec<usize> = watched.into_iter().zip(flags).filter(|(_, flag)| *flag != 0).map(|(at, _)| at).collect();
        if bad.is_empty() {
            return Ok(None);
        }
        Err(Fault { step, view, what: in_words(&bad, gradients.iter().map(|(name, _)| *name)) })
    }

    /// Reads the verdict if `now` is set, or if it has not been read for `READ_EVERY` steps.
    ///
    /// # Errors
    /// The first step with a non-finite value.
    pub fn read(&mut self, now: bool) -> Result<(), Fault> {
        if self.unread.is_empty() || !(now || self.unread.len() >= READ_EVERY) {
            return Ok(());
        }
        let unread = std::mem::take(&mut self.unread);
        let Some(verdict) = &self.verdict else { return Ok(()) };
        let numbers: Vec<i32> = read_back(verdict.clone()).iter().collect();
        let [first, which] = [0, 1].map(|i| numbers[i] as usize);
        match unread.iter().find(|(step, _)| *step == first) {
            None => Ok(()),
            Some(&(step, view)) => {
                let bad: Vec<usize> = (0..=LAST_BIT).filter(|bit| which >> bit & 1 != 0).collect();
                Err(Fault { step, view, what: in_words(&bad, self.names.iter().map(String::as_str)) })
            }
        }
    }
}

/// A flag, `[1]`, for the loss and for each gradient that there is, with its bit in a verdict.
fn flags(loss: &Tensor<1>, gradients: &[(&str, Option<&Tensor<2>>)]) -> Vec<(usize, Tensor<1, Int>)> {
    let of_gradients =
        gradients.iter().enumerate().filter_map(|(i, (_, values))| Some((i + 1, non_finite((*values)?))));
    std::iter::once((0, non_finite(loss))).chain(of_gradients).collect()
}

/// The verdict after a step, in tensor code, for devices without the kernel.
fn entered(verdict: Tensor<1, Int>, flags: Vec<(usize, Tensor<1, Int>)>, step: usize) -> Tensor<1, Int> {
    let step = step as i32;
    flags.into_iter().fold(verdict, |verdict, (place, flag)| {
        let first = verdict.clone().narrow(0, 0, 1);
        let open = first.clone().equal_elem(0).int() + first.clone().equal_elem(step).int();
        let bad = flag * open;
        let entered = first.clone() + bad.clone() * (first.neg() + step);
        Tensor::cat(vec![entered, verdict.narrow(0, 1, 1) + bad * (1 << place.min(LAST_BIT))], 0)
    })
}

/// Names the loss if it is not finite, because its gradients follow from it. Lists the gradients otherwise: `bad` are bits of a
/// verdict, and `names` are those of the gradients, block by block.
fn in_words<'a>(bad: &[usize], names: impl Iterator<Item = &'a str>) -> String {
    if bad.contains(&0) {
        return "the loss".into();
    }
    let is_bad = |i: usize| bad.contains(&(i + 1).min(LAST_BIT));
    let mut names: Vec<String> =
        names.enumerate().filter(|(i, _)| is_bad(*i)).map(|(_, name)| format!("`{name}`")).collect();
    names.dedup();
    format!("the gradient of {}", names.join(", "))
}

#[cfg(test)]
mod tests;
