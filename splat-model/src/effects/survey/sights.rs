//! The places that several photographs show.

use glam::{DVec3, Vec3};
use serde::Serialize;
use splat_op::Projector;

use crate::capture::{Capture, View};

/// Points that are compared at most: more change no median.
const MOST_POINTS: usize = 6_000;

/// A point must be in so many photographs, or a median over them says nothing.
const FEWEST_SIGHTS: usize = 3;

/// Cells along the longer side of a picture, for finding what hides what where there are no tracks.
const CELLS: usize = 24;

/// A point counts as hidden if something in its cell or one beside it is nearer by more than this share.
const HIDDEN_BEHIND: f64 = 0.05;

/// How the photographs of a point are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SightSource {
    /// From the reconstruction's tracks.
    Tracks,
    /// By projecting points, less those that something nearer seems to hide: some are compared that are hidden after all.
    Projection,
    /// There are no points.
    None,
}

/// A point in a photograph.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    pub view: usize,
    pub at_px: [f64; 2],
    /// Along the camera's axis, scene units.
    pub depth: f64,
    /// Pixels per scene unit there: focal length by depth.
    pub footprint: f64,
    /// Filled in when the picture is read; none at its border.
    pub sample: Option<Sample>,
}

/// Display-referred colours around a place, 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Of 3 × 3 px.
    pub mean: [f32; 3],
    /// Of 5 × 5 px: what a shift by a pixel or two could show instead.
    pub low: [f32; 3],
    pub high: [f32; 3],
}

/// Points and their photographs.
pub(super) struct Sights {
    pub source: SightSource,
    pub points: Vec<Vec<Sight>>,
    /// Index into the point cloud of each.
    pub indices: Vec<usize>,
}

impl Sights {
    /// In the photographs `surveyed`, indices in rising order.
    pub fn of(capture: &Capture, surveyed: &[usize]) -> Self {
        let source = match () {
            () if capture.points.positions.is_empty() => SightSource::None,
            () if capture.tracks.observations() > 0 => SightSource::Tracks,
            () => SightSource::Projection,
        };
        let candidates: Vec<(usize, Vec<Sight>)> = match source {
            SightSource::None => Vec::new(),
            SightSource::Tracks => tracked(capture, surveyed),
            SightSource::Projection => projected(capture, surveyed),
        };
        let mut chosen = candidates.into_iter().filter(|(_, sights)| sights.len() >= FEWEST_SIGHTS).collect::<Vec<_>>();
        let every = chosen.len().div_ceil(MOST_POINTS).max(1);
        chosen = chosen.into_iter().step_by(every).collect();
        let (indices, points) = chosen.into_iter().unzip();
        Self { source, points, indices }
    }
}

fn position(capture: &Capture, point: usize) -> DVec3 {
    Vec3::from_array(capture.points.positions[point]).as_dvec3()
}

fn tracked(capture: &Capture, surveyed: &[usize]) -> Vec<(usize, Vec<Sight>)> {
    let of_point = |point: usize| {
        let world = position(capture, point);
        let sights = capture.tracks.of(point).iter().filter(|sight| surveyed.binary_search(&sight.view).is_ok());
        let sight = |at: &crate::capture::Observation| {
            let depth = capture.views[at.view].cam_from_world.transform_point3(world).z;
            let footprint = focal_px(&capture.views[at.view]) / depth;
            let sight = Sight { view: at.view, at_px: at.at_px.map(f64::from), depth, footprint, sample: None };
            (depth > 0.0).then_some(sight)
        };
        (point, sights.filter_map(sight).collect())
    };
    (0..capture.points.positions.len()).map(of_point).collect()
}

/// Every point is projected, to know what hides what; some are compared.
fn projected(capture: &Capture, surveyed: &[usize]) -> Vec<(usize, Vec<Sight>)> {
    let count = capture.points.positions.len();
    let every = count.div_ceil(MOST_POINTS).max(1);
    let mut found: Vec<(usize, Vec<Sight>)> = (0..count).step_by(every).map(|point| (point, Vec::new())).collect();
    for &index in surveyed {
        let view = &capture.views[index];
        let side_px = (view.intrinsics.width.max(view.intrinsics.height) as f64 / CELLS as f64).max(1.0);
        let cell = |[x, y]: [f64; 2]| [(x / side_px) as usize, (y / side_px) as usize];
        let mut nearest = vec![[f64::INFINITY; CELLS + 1]; CELLS + 1];
        let projector = view.intrinsics.projector();
        let shown: Vec<Option<([f64; 2], f64)>> =
            (0..count).map(|point| project(view, &projector, position(capture, point))).collect();
        for (at_px, depth) in shown.iter().flatten() {
            let [column, row] = cell(*at_px);
            nearest[row][column] = nearest[row][column].min(*depth);
        }
        for (point, sights) in &mut found {
            let Some((at_px, depth)) = shown[*point] else { continue };
            let [column, row] = cell(at_px);
            let rows = &nearest[row.saturating_sub(1)..(row + 2).min(CELLS + 1)];
            let around = rows.iter().flat_map(|row| &row[column.saturating_sub(1)..(column + 2).min(CELLS + 1)]);
            let first = around.copied().fold(f64::INFINITY, f64::min);
            if depth * (1.0 - HIDDEN_BEHIND) <= first {
                let footprint = focal_px(view) / depth;
                sights.push(Sight { view: index, at_px, depth, footprint, sample: None });
            }
        }
    }
    found
}

/// Where a point is in the picture of a view with the camera `projector`, px, and its depth; none outside.
pub(super) fn project(view: &View, projector: &Projector, world: DVec3) -> Option<([f64; 2], f64)> {
    let camera = &view.intrinsics;
    let cam = view.cam_from_world.transform_point3(world);
    let at_px = projector.px_from_cam(cam)?.to_array();
    let inside = (0.0..camera.width as f64).contains(&at_px[0]) && (0.0..camera.height as f64).contains(&at_px[1]);
    inside.then_some((at_px, cam.z))
}

fn focal_px(view: &View) -> f64 {
    (view.intrinsics.fx * view.intrinsics.fy).sqrt()
}
