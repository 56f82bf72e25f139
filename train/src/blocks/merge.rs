//! `splat blocks merge`: one scene of the blocks' cells.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use splat_model::capture::Capture;
use splat_model::capture::blocks::{BlockFile, keep};
use splat_model::formats::{self, SceneFile};
use splat_model::gaussians::GaussianRows;
use splat_model::ply::TrainedAs;

use super::planned::PlanFolder;
use crate::convert::format_of;
use crate::inputs::Inputs;
use crate::output::prepare_file;
use crate::report::SCENE;
use crate::train::{RunState, state_of};
use crate::{input, progress};

/// Options of `splat blocks merge`.
#[derive(Clone, Debug, clap::Args)]
pub struct MergeArgs {
    /// Folder of the plan
    #[arg(value_name = "DIR")]
    pub plan: PathBuf,
    /// Scene to write: .ply, .spz, .glb or .sog
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Writes the scene. `splat eval` scores it on the whole capture. An error if a block is not finished, the blocks do
/// not fit together, or the scene is one of the files that are read or cannot be written.
pub fn merge(args: &MergeArgs) -> Result<()> {
    let folder = PlanFolder::open(&args.plan)?;
    let format = format_of(&args.out)?;
    let waiting: Vec<&str> = (folder.plan.blocks.iter())
        .filter(|name| state_of(&folder.run(name)) != RunState::Finished)
        .map(String::as_str)
        .collect();
    if !waiting.is_empty() {
        bail!(
            "{} of {} blocks are not finished ({}): run their lines of jobs.txt; `splat blocks status {}` shows how far they are",
            waiting.len(),
            folder.plan.blocks.len(),
            waiting.join(", "),
            args.plan.display()
        );
    }
    let files = folder.files()?;
    let capture = folder.capture(&files)?;
    prepare_file(&args.out, &Inputs::of(folder.files_of_runs()).and_capture(&capture))?;
    let (merged, trained) = merged(&folder, &files, &capture)?;
    ensure!(!merged.is_empty(), "no block has a splat in its cell: train the blocks again");
    ensure!(
        format.holds_origin() || capture.origin == glam::DVec3::ZERO,
        "{}: the format holds no origin, and the capture lies far from zero: merge to .ply",
        args.out.display()
    );
    let scene = SceneFile {
        rows: merged,
        origin: capture.origin,
        metres_per_unit: capture.world_frame().metres_per_unit,
        trained,
    };
    formats::write(&args.out, &scene, format)?;
    progress::say(&format!("scene: {} ({} splats)", args.out.display(), scene.rows.len()));
    Ok(())
}

/// The rows of all blocks in their cells, block by block, relative to the capture's origin, and how they were trained.
fn merged(folder: &PlanFolder, files: &[BlockFile], capture: &Capture) -> Result<(GaussianRows, TrainedAs)> {
    let (mut merged, mut trained_as) = (None::<GaussianRows>, TrainedAs::default());
    for (name, file) in folder.plan.blocks.iter().zip(files) {
        let (rows, trained, _) = input::rows("--scene", &folder.run(name).join(SCENE), Some(capture))?;
        trained_as = trained;
        let all = merged.get_or_insert_with(|| GaussianRows::like(&rows));
        ensure!(
            rows.sh_degree == all.sh_degree,
            "{name} has harmonics of degree {} and those before it of degree {}: train all with the lines of jobs.txt",
            rows.sh_degree,
            all.sh_degree
        );
        if let Some(group) = all.groups.iter().find(|group| !rows.has_group(group)) {
            bail!("{name} has no group `{}` of {} numbers, as those before it have", group.name, group.width);
        }
        let before = all.len();
        keep(&file.cell, &rows, all);
        progress::note(&format!("{name}: {} of {} splats lie in its cell", all.len() - before, rows.len()));
    }
    Ok((merged.unwrap_or_default(), trained_as))
}
