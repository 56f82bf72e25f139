//! The program `splat` with a loss, a density strategy, an effect and a format of captures of one's own:
//! `cargo run --release -p splat-train --example own_program -- train CAPTURE --loss squares --strategy budget --effects=+filter`.
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use burn::tensor::{DType, Device, Gradients, Tensor};
use glam::{DAffine3, DQuat, DVec3};
use rand::Rng;
use splat_model::capture::{Capture, CaptureError, CaptureFormat, Cut, Pictures, View};
use splat_model::density::rows::{RowEdit, Trained};
use splat_model::density::{
    Observed, RefineReport, Refined, Signals, Strategy, StrategyContext, counts, largest, picked,
};
use splat_model::effects::{Effect, EffectContext, Leaf, Learned, RenderInput};
use splat_model::gaussians::GroupOptions;
use splat_model::loss::photometric;
use splat_model::state::{State, StateError};
use splat_model::trainer::{LossInputs, TrainError, Trainer};
use splat_op::{Intrinsics, Rendered};
use splat_train::registry::{Registry, main_with};

splat_train::allocator!();

/// Photographs as they are, and a number of each Gaussian whose render is the photograph's brightness.
fn brightness(trainer: Trainer) -> Result<Trainer, TrainError> {
    let options = GroupOptions { rate: 0.02, ..GroupOptions::default() };
    Ok(trainer.with_group("brightness", 1, options)?.with_loss(|seen: &LossInputs| {
        let found = seen.features(seen.group("brightness")).expect("a number of each Gaussian");
        photometric(seen.image.clone(), seen.truth, 0.2) + (found - seen.truth.image().mean_dim(2)).abs().mean()
    }))
}

/// At regular intervals clones the Gaussians with the largest accumulated gradients of their centres, up to a budget, and prunes nearly
/// transparent ones.
struct Budget {
    every: usize,
    most: usize,
    /// `[N]`: accumulated length of the gradient of each centre since the last change of rows.
    pulled: Option<Tensor<1>>,
}

impl Strategy for Budget {
    fn listens_at(&self, _step: usize) -> Signals {
        Signals { gradient: true, ..Signals::default() }
    }

    fn observe(&mut self, seen: Observed) {
        let Some(gradient) = seen.gradient else { return };
        let length = gradient.square().sum_dim(1).sqrt().squeeze_dim::<1>(1);
        self.pulled = Some(match self.pulled.take() {
            Some(pulled) => pulled + length,
            None => length,
        });
    }

    fn acts_at(&self, step: usize) -> bool {
        step.is_multiple_of(self.every)
    }

    fn act(&mut self, scene: &mut Trained, at: &StrategyContext, _rng: &mut dyn Rng) -> Refined {
        if !self.acts_at(at.step) || at.step == at.steps {
            return Ok(None);
        }
        let Some(pulled) = self.pulled.take() else { return Ok(None) };
        // All of this is on the device; only the number of rows to keep is read.
        let rows = scene.gaussians.len();
        let device = pulled.device();
        // The logit of 0.01.
        let stays = scene.gaussians.logit_opacities().inner().greater_elem(-4.6);
        let [kept] = counts([stays.clone()]);
        let cloned = self.most.saturating_sub(kept).min(kept / 5);
        let (clones, _) = largest(&pulled, &stays, cloned);
        let order = Tensor::arange(0..rows as i64, (&device, DType::I32));
        let keep = picked(&order, &stays, kept);
        scene.edit(&RowEdit::new(keep, picked(&order, &clones, cloned)))?;
        Ok(Some(RefineReport { cloned, pruned: rows - kept, ..RefineReport::default() }))
    }

    // Saved so that an interrupted run continues without a difference.
    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.pulled.iter().for_each(|pulled| to.put("pulled", pulled.clone()));
        Ok(())
    }

    fn load(&mut self, from: &mut State, device: &Device) -> Result<(), StateError> {
        self.pulled = if from.has("pulled") { Some(from.take("pulled", device)?) } else { None };
        Ok(())
    }
}

/// Learns, together with the scene, which share of the light of photographs 1, 3, 5 and so on, counted from 0, a filter removed.
struct Filter(Learned<1>);

impl Effect for Filter {
    fn name(&self) -> &'static str {
        "filter"
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        if at.view.is_multiple_of(2) {
            return image;
        }
        image * (self.0.tracked().neg() + 1.0).reshape([1, 1, 1])
    }

    fn leaves(&mut self, _: EffectContext) -> Vec<Leaf> {
        vec![self.0.leaf()]
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        self.0.step(gradients, 0.01, at.verdict);
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.0.save(to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        self.0.load(from)
    }
}

/// `cameras.csv`: for each photograph of `images/` its name, width, height and focal length, px, and its pose, camera from world: the
/// quaternion x, y, z, w and the translation.
struct Table;

impl CaptureFormat for Table {
    fn name(&self) -> &'static str {
        "table"
    }

    fn usual(&self, folder: &Path) -> Vec<PathBuf> {
        Some(folder.join("cameras.csv")).filter(|file| file.is_file()).into_iter().collect()
    }

    fn load(&self, cameras: &[PathBuf], _: &Pictures) -> Result<Capture, CaptureError> {
        let damaged = |why: String| CaptureError::Content(format!("{}: {why}", cameras[0].display()));
        let text = std::fs::read_to_string(&cameras[0]).map_err(|reason| damaged(reason.to_string()))?;
        let folder = cameras[0].parent().unwrap_or(Path::new("."));
        let view = |line: &str| {
            let (name, numbers) = line.split_once(',')?;
            let numbers: Vec<f64> = numbers.split(',').map_while(|number| number.parse().ok()).collect();
            let [width, height, focal_px, qx, qy, qz, qw, x, y, z] = numbers[..].try_into().ok()?;
            let rotation = DQuat::from_xyzw(qx, qy, qz, qw).normalize();
            Some(View {
                name: name.to_owned(),
                image_path: folder.join("images").join(name),
                intrinsics: Intrinsics::centred(width as usize, height as usize, focal_px),
                cam_from_world: DAffine3::from_rotation_translation(rotation, DVec3::new(x, y, z)),
                cut: Cut::Whole,
            })
        };
        let views = text.lines().map(|line| view(line).ok_or_else(|| damaged(format!("{line}: not 11 columns"))));
        let views = views.collect::<Result<_, _>>()?;
        Ok(Capture { files: cameras.to_vec(), ..Capture::near_zero(folder, views, &[], Vec::new()) })
    }
}

pub fn registry() -> Registry {
    let squares = || |seen: &LossInputs| (seen.image.clone() - seen.truth.image()).square().mean();
    let registry = Registry::new().loss("squares", squares).loss_with("brightness", brightness);
    registry
        .strategy("budget", |_, _| Budget { every: 10, most: 20_000, pulled: None })
        .effect("filter", |trainer: &Trainer| {
            Filter(Learned::new(Tensor::zeros([1], &trainer.gaussians().means().inner().device())))
        })
        .capture_format(Table)
}

fn main() -> ExitCode {
    main_with(registry())
}
