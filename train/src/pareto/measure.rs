//! Checks of every setting against the exact reference, and times of all in turns.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use burn::tensor::{Device, Tensor};
use splat_model::accuracy::{Dial, Judge};
use splat_model::capture::Photo;
use splat_model::gaussians::GaussianRows;
use splat_op::RenderOptions;

use super::dials::Candidate;
use super::errors::{MeasuredError, compare_gradients};
use super::quartiles::{Quartiles, decibels};
use super::reference::ReferenceRender;
use super::subject::{DeviceScene, GradientSums, PARAMETERS, host, off_the_clamp};
use crate::progress;

/// Minimum number of rounds: fewer have no spread.
pub const ROUNDS_MIN: usize = 3;

/// Times of a frame, ms.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameTimes {
    pub forward: Quartiles,
    pub backward: Quartiles,
    pub step: Quartiles,
}

#[derive(Clone, Debug)]
pub struct SettingMeasurements {
    pub candidate: Candidate,
    /// `None` for model choices, which define another function.
    pub accuracy: Option<MeasuredError>,
    /// Scores against the photographs.
    pub psnr_db: f64,
    pub ssim: f64,
    /// Zero until all settings are checked.
    pub times: FrameTimes,
}

/// The subject of the measurements.
pub struct Bench<'a> {
    pub place: DeviceScene,
    exact: DeviceScene,
    pub photos: &'a [Photo],
    base: RenderOptions,
}

pub struct BenchOutcome {
    pub rows: Vec<SettingMeasurements>,
    /// Largest difference between the reference renderer and the exact renderer in the pixels that both rendered.
    pub reference: f64,
    pub rounds: usize,
}

impl<'a> Bench<'a> {
    /// Prepares a scene and views of it over a colour.
    pub fn new(
        rows: &GaussianRows,
        photos: &'a [Photo],
        background: [f32; 3],
        base: RenderOptions,
        device: &Device,
    ) -> Result<Self> {
        let rows = off_the_clamp(rows);
        let place = DeviceScene::new(&rows, photos, background, device)?;
        Ok(Self { place, exact: DeviceScene::in_f64(&rows, photos, background)?, photos, base })
    }

    /// Checks and scores every candidate, and times all of them in turns until `budget` is spent. `score` gives PSNR, dB, and SSIM.
    pub fn run(
        &self,
        candidates: Vec<Candidate>,
        budget: Duration,
        score: impl Fn(&RenderOptions) -> Result<(f64, f64)>,
    ) -> Result<BenchOutcome> {
        let mut truths: Vec<(RenderOptions, ReferenceRender)> = Vec::new();
        let counter = progress::counter("checking settings", candidates.len());
        let mut rows = Vec::new();
        for candidate in candidates {
            let row = self.check(&candidate, &mut truths, &score);
            rows.push(row.with_context(|| format!("the setting {:?} cannot be measured", candidate.name))?);
            counter.inc(1);
        }
        counter.finish_and_clear();
        let of_base = self.truth(&mut truths, &self.base)?;
        let on_device = |(view, values): (usize, &Vec<f32>)| self.place.picture(view, values);
        let cotangents: Vec<Tensor<3>> = of_base.cotangents.iter().enumerate().map(on_device).collect();
        let reference = truths.iter().map(|(_, truth)| truth.difference).fold(0.0, f64::max);
        drop(truths);
        let rounds = self.time(&mut rows, &cotangents, budget)?;
        Ok(BenchOutcome { rows, reference, rounds })
    }

    /// Returns the exact reference under the model choices of `options`; it is computed once for each.
    fn truth<'t>(
        &self,
        truths: &'t mut Vec<(RenderOptions, ReferenceRender)>,
        options: &RenderOptions,
    ) -> Result<&'t ReferenceRender> {
        let exact = Dial::all_exact(*options);
        let place = match truths.iter().position(|(of, _)| *of == exact) {
            Some(place) => place,
            None => {
                let counter = progress::counter("rendering exactly", self.photos.len());
                let truth = ReferenceRender::new(&self.exact, self.photos, &exact, || counter.inc(1))?;
                truths.push((exact, truth));
                truths.len() - 1
            }
        };
        Ok(&truths[place].1)
    }

    fn check(
        &self,
        candidate: &Candidate,
        truths: &mut Vec<(RenderOptions, ReferenceRender)>,
        score: &impl Fn(&RenderOptions) -> Result<(f64, f64)>,
    ) -> Result<SettingMeasurements> {
        let options = &candidate.options;
        let judged = candidate.setting.judge() == Judge::Exact;
        let truth = self.truth(truths, if judged { options } else { &self.base })?;
        let found = self.compare(options, truth)?;
        let bound = Dial::rms_bound(options);
        ensure!(
            !judged || found.rms <= bound,
            "its pictures differ from the exact ones by {:.2e} (root mean square), more than the {bound:.2e} allowed: it is broken",
            found.rms
        );
        let (accuracy, (psnr_db, ssim)) = (judged.then_some(found), score(options)?);
        let (candidate, times) = (candidate.clone(), FrameTimes::default());
        Ok(SettingMeasurements { candidate, accuracy, psnr_db, ssim, times })
    }

    /// Renders and differentiates every view. Returns the deviations.
    fn compare(&self, options: &RenderOptions, truth: &ReferenceRender) -> Result<MeasuredError> {
        let (mut squares, mut count, mut max) = (0.0, 0, 0.0_f64);
        let mut sums = GradientSums::default();
        for view in 0..self.photos.len() {
            let cotangent = self.place.picture(view, &truth.cotangents[view]);
            let picture = self.place.tracked(view, options)?;
            let colour = picture.colour.clone().inner();
            let gradients = self.place.backward(picture, cotangent);
            self.place.add_gradients(&gradients, &mut sums);
            let found = host(colour);
            if let Some(at) = found.iter().position(|value| !value.is_finite()) {
                bail!("value {at} of the picture of view {view} is {}", found[at]);
            }
            count += found.len();
            for (found, exact) in found.iter().zip(&truth.pictures[view]) {
                let difference = (found - exact).abs();
                squares += difference * difference;
                max = max.max(difference);
            }
        }
        if let Some(kind) = (0..sums.len()).find(|&kind| !sums[kind].iter().all(|value| value.is_finite())) {
            bail!("a gradient of {} is not finite", PARAMETERS[kind]);
        }
        let (gradient_error, worst, gradient_cosine) = compare_gradients(&sums, &truth.gradients);
        let rms = (squares / count as f64).sqrt();
        Ok(MeasuredError { rms, max, gradient_error, worst, gradient_cosine })
    }

    /// Times all settings on all views in turns, so that other load on the machine affects all alike. Every setting has
    /// run before, in its check, so kernels are compiled. After `budget` no round begins, unless there were fewer than
    /// [`ROUNDS_MIN`]. Returns the number of rounds.
    fn time(&self, settings: &mut [SettingMeasurements], cotangents: &[Tensor<3>], budget: Duration) -> Result<usize> {
        let begin = Instant::now();
        let mut samples = vec![[const { Vec::new() }; 3]; settings.len()];
        let mut rounds = 0;
        while rounds < ROUNDS_MIN || begin.elapsed() < budget {
            for (setting, samples) in settings.iter().zip(&mut samples) {
                let options = &setting.candidate.options;
                let forward = self.time_forward(options)?;
                let backward = self.time_backward(options, cotangents)?;
                for (samples, ms) in samples.iter_mut().zip([forward, backward, forward + backward]) {
                    samples.push(ms);
                }
            }
            rounds += 1;
        }
        let spread = |samples: &Vec<f64>| Quartiles::of(samples).context("a time is not finite");
        for (setting, [forward, backward, step]) in settings.iter_mut().zip(&samples) {
            setting.times = FrameTimes { forward: spread(forward)?, backward: spread(backward)?, step: spread(step)? };
        }
        Ok(rounds)
    }

    /// Time of a frame, ms.
    fn time_forward(&self, options: &RenderOptions) -> Result<f64> {
        let views = 0..self.photos.len();
        self.place.device.sync()?;
        let start = Instant::now();
        // Kept until they are computed: a result that nobody waits for may never be computed.
        let pictures: Vec<_> = views.clone().map(|view| self.place.render(view, options)).collect::<Result<_>>()?;
        self.place.device.sync()?;
        let elapsed = start.elapsed();
        drop(pictures);
        Ok(1e3 * elapsed.as_secs_f64() / views.len() as f64)
    }

    /// Time of a frame's backward pass, ms.
    fn time_backward(&self, options: &RenderOptions, cotangents: &[Tensor<3>]) -> Result<f64> {
        let mut elapsed = Duration::ZERO;
        for (view, cotangent) in cotangents.iter().enumerate() {
            let picture = self.place.tracked(view, options)?;
            self.place.device.sync()?;
            let start = Instant::now();
            let gradients = self.place.backward(picture, cotangent.clone());
            self.place.device.sync()?;
            elapsed += start.elapsed();
            drop(gradients);
        }
        Ok(1e3 * elapsed.as_secs_f64() / cotangents.len() as f64)
    }
}

impl SettingMeasurements {
    /// PSNR against the exact render, dB; `None` where photographs are the judge.
    pub fn error_db(&self) -> Option<f64> {
        Some(decibels(self.accuracy.as_ref()?.rms))
    }
}

#[cfg(test)]
mod tests;
