//! Observations of points in several photographs.

use serde::Serialize;

use super::detail::Detail;
use crate::capture::seen::project;
use crate::capture::{Capture, Observation, View};

/// Largest number of compared points. More points do not change medians.
const MOST_POINTS: usize = 6_000;

/// Smallest number of photographs of a point. With fewer, a median over them means little.
const FEWEST_OBSERVATIONS: usize = 3;

/// Cells along the longer side of a picture, for the occlusion test without tracks.
const CELLS: usize = 24;

/// A point counts as hidden if a point in its cell or a neighbouring cell is nearer by more than this share.
const HIDDEN_BEHIND: f64 = 0.05;

/// How the photographs of a point were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ObservationSource {
    /// By the reconstruction's tracks.
    Tracks,
    /// By projecting points and leaving out those that a nearer point seems to hide. Some hidden points remain.
    Projection,
    /// There are no points.
    None,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct PointObservation {
    pub view: usize,
    pub at_px: [f64; 2],
    /// Depth along the camera's axis, scene units.
    pub depth: f64,
    /// Pixels per scene unit at the point: focal length divided by depth.
    pub footprint: f64,
    /// Set when the photograph is decoded. `None` at its border.
    pub sample: Option<ColourSample>,
}

/// Display-referred colours around a place, 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct ColourSample {
    /// Mean of 3 × 3 px.
    pub mean: [f32; 3],
    /// Smallest and largest value of 5 × 5 px: the range that a shift by a pixel or two could show.
    pub low: [f32; 3],
    pub high: [f32; 3],
    /// Energies of differences in the neighbourhood. `None` near the border.
    pub detail: Option<Detail>,
}

pub(super) struct PointObservations {
    pub source: ObservationSource,
    pub points: Vec<Vec<PointObservation>>,
    /// Index of each point in the point cloud.
    pub indices: Vec<usize>,
}

impl PointObservations {
    /// Collects the observations in the photographs `surveyed`, indices in ascending order.
    pub fn of(capture: &Capture, surveyed: &[usize]) -> Self {
        let (source, mut found) = match () {
            () if capture.points.positions.is_empty() => (ObservationSource::None, Vec::new()),
            () if capture.tracks.observations() > 0 => (ObservationSource::Tracks, tracked(capture, surveyed)),
            () => (ObservationSource::Projection, projected(capture, surveyed)),
        };
        found.retain(|(_, observations)| observations.len() >= FEWEST_OBSERVATIONS);
        let every = found.len().div_ceil(MOST_POINTS).max(1);
        let (indices, points) = found.into_iter().step_by(every).unzip();
        Self { source, points, indices }
    }
}

fn tracked(capture: &Capture, surveyed: &[usize]) -> Vec<(usize, Vec<PointObservation>)> {
    let of_point = |point: usize| {
        let world = capture.position(point);
        let observations =
            capture.tracks.of(point).iter().filter(|observation| surveyed.binary_search(&observation.view).is_ok());
        let observation = |at: &Observation| {
            let depth = capture.views[at.view].cam_from_world.transform_point3(world).z;
            let footprint = focal_px(&capture.views[at.view]) / depth;
            let observation =
                PointObservation { view: at.view, at_px: at.at_px.map(f64::from), depth, footprint, sample: None };
            (depth > 0.0).then_some(observation)
        };
        (point, observations.filter_map(observation).collect())
    };
    (0..capture.points.positions.len()).map(of_point).collect()
}

/// Projects all points for the occlusion test. The caller compares some of them.
fn projected(capture: &Capture, surveyed: &[usize]) -> Vec<(usize, Vec<PointObservation>)> {
    let count = capture.points.positions.len();
    let every = count.div_ceil(MOST_POINTS).max(1);
    let mut found: Vec<(usize, Vec<PointObservation>)> =
        (0..count).step_by(every).map(|point| (point, Vec::new())).collect();
    for &index in surveyed {
        let view = &capture.views[index];
        let side_px = (view.intrinsics.width.max(view.intrinsics.height) as f64 / CELLS as f64).max(1.0);
        let cell = |[x, y]: [f64; 2]| [(x / side_px) as usize, (y / side_px) as usize];
        let mut nearest = vec![[f64::INFINITY; CELLS + 1]; CELLS + 1];
        let View { intrinsics: camera, cam_from_world: pose, .. } = view;
        let projector = camera.projector();
        let shown: Vec<Option<([f64; 2], f64)>> =
            (0..count).map(|point| project(camera, &projector, pose, capture.position(point))).collect();
        for (at_px, depth) in shown.iter().flatten() {
            let [column, row] = cell(*at_px);
            nearest[row][column] = nearest[row][column].min(*depth);
        }
        for (point, observations) in &mut found {
            let Some((at_px, depth)) = shown[*point] else { continue };
            let [column, row] = cell(at_px);
            let rows = &nearest[row.saturating_sub(1)..(row + 2).min(CELLS + 1)];
            let around = rows.iter().flat_map(|row| &row[column.saturating_sub(1)..(column + 2).min(CELLS + 1)]);
            let first = around.copied().fold(f64::INFINITY, f64::min);
            if depth * (1.0 - HIDDEN_BEHIND) <= first {
                let footprint = focal_px(view) / depth;
                observations.push(PointObservation { view: index, at_px, depth, footprint, sample: None });
            }
        }
    }
    found
}

fn focal_px(view: &View) -> f64 {
    (view.intrinsics.fx * view.intrinsics.fy).sqrt()
}
