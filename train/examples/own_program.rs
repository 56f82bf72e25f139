//! The program `splat` with a loss, a density strategy, an effect and a format of captures of one's own:
//! `cargo run --release -p splat-train --example own_program -- train CAPTURE --loss squares --strategy still --effects=+dim`.
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use burn::tensor::Tensor;
use glam::{DAffine3, DQuat, DVec3};
use rand::Rng;
use splat_model::capture::{Capture, CaptureError, CaptureFormat, Pictures, View};
use splat_model::density::rows::Trained;
use splat_model::density::{RefineReport, Strategy, StrategyContext};
use splat_model::effects::{Effect, EffectContext, RenderInput};
use splat_model::gaussians::{GroupOptions, RowsError};
use splat_model::loss::photometric;
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

/// Keeps the Gaussians that a run starts with.
struct Still;

impl Strategy for Still {
    fn acts_at(&self, _: usize) -> bool {
        false
    }

    fn act(
        &mut self,
        _: &mut Trained,
        _: &StrategyContext,
        _: &mut dyn Rng,
    ) -> Result<Option<RefineReport>, RowsError> {
        Ok(None)
    }
}

/// Shows every photograph through a grey filter.
struct Dim;

impl Effect for Dim {
    fn name(&self) -> &'static str {
        "dim"
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, _: EffectContext) -> Tensor<3> {
        image * 0.8
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
    registry.strategy("still", |_, _| Still).effect("dim", |_: &Trainer| Dim).capture_format(Table)
}

fn main() -> ExitCode {
    main_with(registry())
}
