//! What a run starts from: the points of its capture, and the scene of `--start`.

use anyhow::{Result, ensure};
use glam::DVec3;
use splat_model::capture::{Capture, Photograph, PointCloud, PointsSeen};
use splat_model::init;
use splat_model::trainer::Trainer;

use super::TrainArgs;
use crate::{input, progress};

/// Gives a trainer the scene of `--start`, if there is one. Of a block, points beyond its region are left out then: the scene shows what
/// lies there.
///
/// # Errors
/// If the scene cannot be read, or has more splats than the run may have.
pub(crate) fn started(trainer: Trainer, args: &TrainArgs, capture: &Capture) -> Result<Trainer> {
    let Some(path) = &args.start else { return Ok(trainer) };
    let (rows, _) = input::rows("--start", path, capture)?;
    ensure!(
        rows.len() <= args.max_splats,
        "{} has {} splats, and `--max-splats` is {}: name a smaller scene with `--start`, or raise `--max-splats`",
        path.display(),
        rows.len(),
        args.max_splats
    );
    Ok(trainer.from_scene(&rows, &points(capture))?)
}

/// Share of the points that remain where each place counts once, up to which that is worth a note.
const REPEATED: f64 = 0.9;

/// The points of a capture that a run on these photographs starts from, each place once. Says how many of them the photographs show.
///
/// # Errors
/// If they show none, without a scene to start from: no splat would be left.
pub(crate) fn start_points(capture: &Capture, train: &[Photograph], args: &TrainArgs) -> Result<PointCloud> {
    let (all, points) = (capture.points.positions.len(), init::distinct(&capture.points));
    let count = points.positions.len();
    let cameras: Vec<_> = train.iter().map(|photo| (photo.intrinsics, photo.cam_from_world)).collect();
    if count > 0 {
        let seen = PointsSeen::of(&cameras, &capture.points.positions);
        let said = seen.said(|view| &train[view].name);
        ensure!(seen.unseen < all || args.start.is_some(), "no splat would be left: {said}");
        progress::note(&said);
    }
    if count as f64 <= REPEATED * all as f64 {
        progress::note(&format!("{} of {all} points are at the place of another one and left out", all - count));
    }
    Ok(points)
}

/// Whether a run on these views starts from random splats, all or most of them, because the capture has no points or few. Says so.
pub(crate) fn is_random(capture: &Capture, views: &[usize], max_side: Option<u32>) -> bool {
    let points = init::distinct(&capture.points).positions.len();
    let pixels = capture.mean_pixels(views, max_side) * views.len() as f64;
    let missing = init::missing(points, views.len(), pixels as usize);
    match (missing, points) {
        (0, _) => return false,
        (_, 0) => progress::note("the capture has no points: training starts from random splats around the cameras"),
        _ => progress::note(&format!(
            "the capture has {points} points, which are few: training starts from {missing} random splats around the cameras too"
        )),
    }
    true
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
