//! `--start`: a scene from which a run starts.

use anyhow::{Result, ensure};
use glam::DVec3;
use splat_model::capture::{Capture, PointCloud};
use splat_model::trainer::Trainer;

use super::TrainArgs;
use crate::input;

/// Gives a trainer the scene of `--start`, if there is one. Of a block, points beyond its region are left out then: the scene shows what
/// lies there.
///
/// # Errors
/// If the scene cannot be read, or has more splats than the run may have.
pub(crate) fn started(trainer: Trainer, args: &TrainArgs, capture: &Capture) -> Result<Trainer> {
    let Some(path) = &args.start else { return Ok(trainer) };
    let (rows, _) = input::rows_of("--start", path, capture)?;
    ensure!(
        rows.len() <= args.max_splats,
        "{} has {} splats, and `--max-splats` is {}: name a smaller scene with `--start`, or raise `--max-splats`",
        path.display(),
        rows.len(),
        args.max_splats
    );
    Ok(trainer.from_scene(&rows, &points(capture))?)
}

/// The points in the region of a block, or all points of a whole capture.
fn points(capture: &Capture) -> PointCloud {
    let PointCloud { positions, colours } = &capture.points;
    let is_within =
        |position: &[f32; 3]| capture.focus.is_none_or(|region| region.contains(DVec3::from(position.map(f64::from))));
    let within = positions.iter().zip(colours).filter(|(position, _)| is_within(position));
    let (positions, colours) = within.map(|(position, colour)| (*position, *colour)).unzip();
    PointCloud { positions, colours }
}
