//! Short runs under training dials: scores on the held-out photographs against seconds.

use std::time::Instant;

use anyhow::{Context, Result};
use burn::tensor::Device;
use splat_model::accuracy::Preset;
use splat_model::capture::{Photo, PointCloud};
use splat_model::effects::background::Background;
use splat_model::evaluate::evaluate;
use splat_model::optim::MomentBits;
use splat_model::trainer::{Resolution, TrainConfig, Trainer};

use super::quartiles::Quartiles;
use crate::progress;

/// Runs of each variant, with different seeds. The spread of a score is its variation from run to run.
const RUNS: u64 = 3;

/// A variant of training.
pub struct Way {
    pub name: &'static str,
    /// Its options of `splat train`; `{N}` stands for the number of steps.
    pub flags: &'static str,
    change: fn(&mut TrainConfig),
}

impl Way {
    /// Returns the configuration of a run.
    fn of(&self, config: &TrainConfig) -> TrainConfig {
        let mut config = config.clone();
        (self.change)(&mut config);
        config
    }
}

/// The variants. The others are compared with the first.
pub const WAYS: &[Way] = &[
    Way { name: "standard", flags: "", change: |_| () },
    Way { name: "half the steps", flags: "--steps {N/2}", change: |config| rescale(config, (config.steps / 2).max(1)) },
    Way { name: "twice the steps", flags: "--steps {2N}", change: |config| rescale(config, 2 * config.steps) },
    Way { name: "halves first", flags: "--coarsest 2", change: |config| config.resolution = coarse(2) },
    Way { name: "quarters first", flags: "--coarsest 4", change: |config| config.resolution = coarse(4) },
    Way {
        name: "twice the steps, quarters first",
        flags: "--steps {2N} --coarsest 4",
        change: |config| {
            rescale(config, 2 * config.steps);
            config.resolution = coarse(4);
        },
    },
    Way { name: "all harmonics at once", flags: "--sh-every 0", change: |config| config.sh_every = 0 },
    Way {
        name: "harmonics by quarters",
        flags: "--sh-every {N/4}",
        change: |config| config.sh_every = (config.steps / 4).max(1),
    },
    Way {
        name: "moments of 16 bits",
        flags: "--moment-bits 16",
        change: |config| config.moment_bits = MomentBits::Sixteen,
    },
    Way {
        name: "moments of 8 bits",
        flags: "--moment-bits 8",
        change: |config| config.moment_bits = MomentBits::Eight,
    },
    Way { name: "no harmonics", flags: "--sh-degree 0", change: |config| config.sh_degree = 0 },
    Way { name: "fast renders", flags: "--accuracy fast", change: |config| preset(config, Preset::Fast) },
    Way { name: "exact renders", flags: "--accuracy exact", change: |config| preset(config, Preset::Exact) },
];

/// Changes the number of steps, and what `splat train` makes depend on it.
fn rescale(config: &mut TrainConfig, steps: usize) {
    *config = std::mem::take(config).with_steps(steps);
}

/// Applies a preset and keeps the model choices.
fn preset(config: &mut TrainConfig, preset: Preset) {
    config.dials = std::mem::take(&mut config.dials).and(&preset.setting());
}

fn coarse(coarsest_divisor: usize) -> Resolution {
    Resolution { coarsest_divisor, ..Resolution::FULL }
}

/// Results of a variant.
#[derive(Clone, Debug)]
pub struct TrainingResult {
    pub name: &'static str,
    pub flags: String,
    /// PSNR of the held-out photographs over the runs, dB.
    pub psnr: Quartiles,
    /// Duration of the steps, s.
    pub seconds: Quartiles,
    /// Number of Gaussians at the end of the last run.
    pub splats: usize,
}

/// Input of the runs.
pub struct Runs<'a> {
    pub train: &'a [Photo],
    pub test: &'a [Photo],
    pub points: &'a PointCloud,
    pub extent: f64,
    pub config: TrainConfig,
    pub device: &'a Device,
}

impl Runs<'_> {
    /// Trains every variant, in turns.
    pub fn all(&self) -> Result<Vec<TrainingResult>> {
        let counter = progress::counter("training", RUNS as usize * WAYS.len());
        let mut found = vec![(Vec::new(), Vec::new(), 0); WAYS.len()];
        for seed in 0..RUNS {
            for (way, found) in WAYS.iter().zip(&mut found) {
                let (psnr, seconds, splats) =
                    self.one(way, seed).with_context(|| format!("the run {:?} failed", way.name))?;
                progress::note(&format!("trained, {}: {psnr:.2} dB in {seconds:.1} s", way.name));
                found.0.push(psnr);
                found.1.push(seconds);
                found.2 = splats;
                counter.inc(1);
            }
        }
        counter.finish_and_clear();
        let steps = self.config.steps;
        let trained = WAYS.iter().zip(found).map(|(way, (psnr, seconds, splats))| {
            let flags = [("{N/2}", steps / 2), ("{N/4}", steps / 4), ("{2N}", 2 * steps)];
            let flags =
                flags.iter().fold(way.flags.to_owned(), |text, (name, number)| text.replace(name, &number.to_string()));
            let spread = |values: &[f64]| Quartiles::of(values).context("a score is not finite");
            Ok(TrainingResult { name: way.name, flags, psnr: spread(&psnr)?, seconds: spread(&seconds)?, splats })
        });
        trained.collect()
    }

    fn one(&self, way: &Way, seed: u64) -> Result<(f64, f64, usize)> {
        let config = TrainConfig { seed, ..way.of(&self.config) };
        // All scenes are scored with the same render settings, however they were trained.
        let shown = TrainConfig { dials: self.config.dials.clone(), ..config.clone() }.render_options(self.extent);
        let mut trainer = Trainer::new(self.train.to_vec(), self.points, config, self.device)?;
        self.device.sync()?;
        let start = Instant::now();
        while !trainer.is_done() {
            trainer.step()?;
        }
        self.device.sync()?;
        let seconds = start.elapsed().as_secs_f64();
        let splats = trainer.gaussians().untracked().splats();
        let background = Background::Colour(self.config.background);
        let scores = evaluate(&splats, self.test, &background, &shown, |_, _| ())?;
        Ok((scores.psnr, seconds, splats.means.dims()[0]))
    }
}

#[cfg(test)]
mod tests;
