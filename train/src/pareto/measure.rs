//! Checks of every setting against the exact reference; the times are in `time.rs`.

use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use burn::tensor::{Device, Tensor};
use splat_model::accuracy::{DIALS, Dial, Judge};
use splat_model::capture::Photo;
use splat_model::gaussians::GaussianRows;
use splat_op::RenderOptions;

use super::dials::Candidate;
use super::errors::{MeasuredError, PictureError, compare_gradients, same_bits, within_rounding};
use super::quartiles::decibels;
use super::reference::ReferenceRender;
use super::subject::{DeviceScene, GradientSums, PARAMETERS, host, off_the_clamp};
use super::time::FrameTimes;
use crate::memory::peak_mib;
use crate::progress;

/// All measurements of one setting.
#[derive(Clone, Debug)]
pub struct SettingMeasurements {
    pub candidate: Candidate,
    /// `None` for model choices, which define another function.
    pub accuracy: Option<MeasuredError>,
    /// Scores against the photographs.
    pub psnr_db: f64,
    pub ssim: f64,
    /// Peak memory of a render with its backward pass, MiB; `None` where it is unknown.
    pub memory_mib: Option<f64>,
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

/// Results of the measurements.
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
                counter.finish_and_clear();
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
        self.check_same_picture(options, &self.same_picture(options))?;
        let judged = candidate.judge() == Judge::Exact;
        let truth = self.truth(truths, if judged { options } else { &self.base })?;
        let (found, memory_mib) = self.compare(options, truth)?;
        let bound = Dial::rms_bound(options);
        ensure!(
            !judged || found.rms <= bound,
            "its pictures differ from the exact ones by {:.2e} (root mean square), more than the {bound:.2e} allowed: it is broken",
            found.rms
        );
        let (accuracy, (psnr_db, ssim)) = (judged.then_some(found), score(options)?);
        let (candidate, times) = (candidate.clone(), FrameTimes::default());
        Ok(SettingMeasurements { candidate, accuracy, psnr_db, ssim, memory_mib, times })
    }

    /// Returns `options` with each dial that promises the same picture at the value of the base.
    fn same_picture(&self, options: &RenderOptions) -> RenderOptions {
        DIALS
            .iter()
            .filter(|dial| dial.same_picture)
            .fold(*options, |options, dial| dial.value_in(&self.base).map_or(options, |value| (value.set)(options)))
    }

    /// Checks pictures that are promised to be equal: bit for bit on a CPU; within rounding on a GPU, which sums longer
    /// lists in other groups.
    fn check_same_picture(&self, options: &RenderOptions, plain: &RenderOptions) -> Result<()> {
        if plain == options {
            return Ok(());
        }
        for view in 0..self.photos.len() {
            let ours = host(self.place.render(view, options)?.colour);
            let theirs = host(self.place.render(view, plain)?.colour);
            let same = match splat_op::is_gpu(&self.place.device) {
                true => within_rounding(&ours, &theirs),
                false => same_bits(&ours, &theirs),
            };
            ensure!(same, "it must not change the picture, and changes view {view}");
        }
        Ok(())
    }

    /// Renders and differentiates every view. Returns the deviations and the peak memory, MiB.
    fn compare(&self, options: &RenderOptions, truth: &ReferenceRender) -> Result<(MeasuredError, Option<f64>)> {
        let mut pictures = PictureError::default();
        let mut sums = GradientSums::default();
        let mut memory = None;
        for view in 0..self.photos.len() {
            let cotangent = self.place.picture(view, &truth.cotangents[view]);
            let (done, peak) = peak_mib(|| -> Result<_> {
                let picture = self.place.tracked(view, options)?;
                let colour = picture.colour.clone().inner();
                let gradients = self.place.backward(picture, cotangent);
                self.place.device.sync()?;
                Ok((colour, gradients))
            });
            let (colour, gradients) = done?;
            memory = peak.into_iter().chain(memory).reduce(f64::max);
            self.place.add_gradients(&gradients, &mut sums);
            let found = host(colour);
            if let Some(at) = found.iter().position(|value| !value.is_finite()) {
                bail!("value {at} of the picture of view {view} is {}", found[at]);
            }
            pictures = pictures.and(PictureError::between(&found, &truth.pictures[view]));
        }
        if let Some(kind) = (0..sums.len()).find(|&kind| !sums[kind].iter().all(|value| value.is_finite())) {
            bail!("a gradient of {} is not finite", PARAMETERS[kind]);
        }
        let (gradient_error, worst, gradient_cosine) = compare_gradients(&sums, &truth.gradients);
        // The memory of the program says nothing about that of a GPU.
        let memory = memory.filter(|_| !splat_op::is_gpu(&self.place.device));
        let (rms, max) = (pictures.rms(), pictures.max);
        Ok((MeasuredError { rms, max, gradient_error, worst, gradient_cosine }, memory))
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
