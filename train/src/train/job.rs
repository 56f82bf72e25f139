//! What every rank of a run has: its options with all decisions, and the photographs and the trainer that follow from them.

use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

use anyhow::{Result, ensure};
use burn::tensor::Device;
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use splat_model::capture::{Capture, Photograph, PointCloud, PointsSeen};
use splat_model::effects::EffectKind;
use splat_model::init;
use splat_model::trainer::ranks::{Alone, Ranks};
use splat_model::trainer::{TrainConfig, Trainer};

use super::{TrainArgs, budget};
use crate::effects::ChosenEffects;
use crate::input::PhotoSelection;
use crate::{input, progress};

/// A run that is decided on.
pub(crate) struct Job {
    pub args: TrainArgs,
    pub config: TrainConfig,
    pub capture: Arc<Capture>,
    pub effects: ChosenEffects,
    pub device: Device,
}

/// Share of the points that remain where each place counts once, up to which that is worth a note.
const REPEATED: f64 = 0.9;

impl Job {
    /// Returns the photographs to train on and those to test on. Those to train on come first where memory does not hold all.
    pub fn photographs(
        &self,
        train: &[usize],
        test: &[usize],
        ranks: &dyn Ranks,
    ) -> Result<(Vec<Photograph>, Vec<Photograph>)> {
        let room = budget::cache(self.args.cache_mb, budget::available()) / ranks.count();
        let wanted = PhotoSelection {
            capture: &self.capture,
            max_side: self.args.photos.max_side,
            masked: self.effects.has(EffectKind::Masks),
            opaque: !self.effects.has(EffectKind::Alpha),
        };
        let train = wanted.read(train, room, ranks)?;
        let left = room.saturating_sub(train.iter().filter(|photo| photo.is_kept()).map(Photograph::bytes).sum());
        Ok((train, wanted.read(test, left, &Alone)?))
    }

    /// Makes the trainer of these photographs. A run that `is_new` has the scene of `--start`, if there is one. An error if no splat would
    /// be left, or the scene of `--start` cannot be read or has more splats than the run may have.
    pub fn trainer(&self, train: Vec<Photograph>, is_new: bool, ranks: &Rc<dyn Ranks>) -> Result<Trainer> {
        let by_name: BTreeMap<&str, usize> =
            self.capture.views.iter().enumerate().map(|(i, view)| (view.name.as_str(), i)).collect();
        let views: Vec<usize> = train.iter().map(|photo| by_name[photo.name.as_str()]).collect();
        let mut points = self.points(&train)?;
        if is_new && self.args.start.is_none() {
            self.add_matched(&mut points, &train)?;
        }
        let mut trainer = self.args.supply(Trainer::of(train, &points, self.config.clone(), &self.device)?)?;
        if is_new {
            trainer = self.started(trainer)?;
        }
        Ok(self.effects.supply(trainer, &self.capture, &views)?.with_ranks(Rc::clone(ranks)))
    }

    /// The points of the capture that the run starts from, each place once. Says how many of them the photographs show.
    fn points(&self, train: &[Photograph]) -> Result<PointCloud> {
        let (all, points) = (self.capture.points.positions.len(), init::distinct(&self.capture.points));
        let count = points.positions.len();
        if count > 0 {
            let cameras: Vec<_> = train.iter().map(|photo| (photo.intrinsics, photo.cam_from_world)).collect();
            let seen = PointsSeen::of(&cameras, &self.capture.points.positions);
            let said = seen.said(|view| &train[view].name);
            ensure!(seen.unseen < all || self.args.start.is_some(), "no splat would be left: {said}");
            progress::note(&said);
        }
        if count as f64 <= REPEATED * all as f64 {
            progress::note(&format!("{} of {all} points are at the place of another one and left out", all - count));
        }
        Ok(points)
    }

    /// Adds points that the photographs show where the capture has few, and says how many.
    fn add_matched(&self, points: &mut PointCloud, train: &[Photograph]) -> Result<()> {
        let own = points.positions.len();
        let pixels = train.iter().map(|photo| photo.intrinsics.width * photo.intrinsics.height).sum();
        let missing = init::missing(own, pixels).min(self.config.density.max_splats().saturating_sub(own));
        if missing == 0 {
            return Ok(());
        }
        let found = init::matched_points(train, missing, &mut ChaCha8Rng::seed_from_u64(self.config.seed))?;
        points.positions.extend(found.positions);
        points.colours.extend(found.colours);
        progress::note(&match (own, points.positions.len() - own) {
            (0, 0) => "the capture has no points: training starts from random splats around the cameras".into(),
            (0, found) => format!("the capture has no points: training starts from {found} that its photographs show"),
            (_, found) => format!("the capture has {own} points, which are few: its photographs show {found} more"),
        });
        Ok(())
    }

    /// Gives the trainer the scene of `--start`, if there is one. Of a block, points beyond its region are left out then: the scene shows
    /// what lies there.
    fn started(&self, trainer: Trainer) -> Result<Trainer> {
        let Some(path) = &self.args.start else { return Ok(trainer) };
        let (rows, ..) = input::rows("--start", path, Some(&self.capture))?;
        ensure!(
            rows.len() <= self.args.max_splats,
            "{} has {} splats, and `--max-splats` is {}: name a smaller scene with `--start`, or raise `--max-splats`",
            path.display(),
            rows.len(),
            self.args.max_splats
        );
        let PointCloud { positions, colours } = &self.capture.points;
        let region = self.capture.focus;
        let is_within =
            |position: &[f32; 3]| region.is_none_or(|region| region.contains(DVec3::from(position.map(f64::from))));
        let within = positions.iter().zip(colours).filter(|(position, _)| is_within(position));
        let (positions, colours) = within.map(|(position, colour)| (*position, *colour)).unzip();
        Ok(trainer.from_scene(&rows, &PointCloud { positions, colours })?)
    }
}
