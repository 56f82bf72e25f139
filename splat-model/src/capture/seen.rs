//! Which photographs show which sparse points.

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use serde::Serialize;
use splat_op::{Intrinsics, Projector};

use super::{Capture, View};

/// Largest number of points that are looked at, evenly spaced. More points do not change what is said of them.
const MOST_POINTS: usize = 50_000;

/// Why no photograph may show a point.
const MISMATCH: &str = "the axes of the cameras or of the points may be of another convention (OpenGL's cameras look along -z, OpenCV's and \
                        COLMAP's along +z), or the points of another world or unit";

/// Projects a point, world frame, into a photograph: position, px, and depth. `None` outside of the picture.
pub(crate) fn project(
    camera: &Intrinsics,
    projector: &Projector,
    cam_from_world: &DAffine3,
    world: DVec3,
) -> Option<([f64; 2], f64)> {
    let cam = cam_from_world.transform_point3(world);
    let at_px = projector.px_from_cam(cam)?.to_array();
    let inside = (0.0..camera.width as f64).contains(&at_px[0]) && (0.0..camera.height as f64).contains(&at_px[1]);
    inside.then_some((at_px, cam.z))
}

impl Capture {
    /// The points that each of some views shows, ascending, of every `step`th point. The tracks say it. Without tracks it is every point
    /// that is projected into the picture, hidden or not.
    pub(crate) fn shown(&self, views: &[usize], step: usize) -> Vec<Vec<u32>> {
        // COLMAP numbers points with 32 bits in practice; more do not fit into memory beside their tracks.
        let points = (0..self.points.positions.len() as u32).step_by(step);
        if self.tracks.observations() > 0 {
            let mut shown = vec![Vec::new(); self.views.len()];
            points
                .for_each(|point| self.tracks.of(point as usize).iter().for_each(|seen| shown[seen.view].push(point)));
            shown.iter_mut().for_each(Vec::dedup);
            return views.iter().map(|&view| std::mem::take(&mut shown[view])).collect();
        }
        let of_view = |&view: &usize| {
            let View { intrinsics, cam_from_world, .. } = &self.views[view];
            let (projector, position) = (intrinsics.projector(), |point: u32| self.position(point as usize));
            let is_shown = |point: &u32| project(intrinsics, &projector, cam_from_world, position(*point)).is_some();
            points.clone().filter(is_shown).collect()
        };
        views.par_iter().map(of_view).collect()
    }
}

/// How many points project into each photograph. Nothing hides anything.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PointsSeen {
    /// Number of points.
    pub points: usize,
    /// Number of points that no photograph shows.
    pub unseen: usize,
    /// Number of points that each photograph shows.
    pub by_view: Vec<usize>,
}

impl PointsSeen {
    /// Projects these positions, world frame, into photographs of these cameras, `cam_from_world`. Of more than 50,000 points some are
    /// looked at, and the numbers are for all.
    pub fn of(cameras: &[(Intrinsics, DAffine3)], positions: &[[f32; 3]]) -> Self {
        let points = positions.len();
        let step = points.div_ceil(MOST_POINTS).max(1);
        let some: Vec<DVec3> = positions.iter().step_by(step).map(|point| Vec3::from(*point).as_dvec3()).collect();
        let seen: Vec<AtomicBool> = some.iter().map(|_| AtomicBool::new(false)).collect();
        let of_view = |(camera, pose): &(Intrinsics, DAffine3)| {
            let projector = camera.projector();
            let shown =
                some.iter().zip(&seen).filter(|(point, _)| project(camera, &projector, pose, **point).is_some());
            (shown.inspect(|(_, seen)| seen.store(true, Ordering::Relaxed)).count() * step).min(points)
        };
        let by_view = cameras.par_iter().map(of_view).collect();
        let unseen = seen.iter().filter(|seen| !seen.load(Ordering::Relaxed)).count();
        Self { points, unseen: (unseen * step).min(points), by_view }
    }

    /// What to tell the user of a capture's points; `name` gives a photograph's.
    pub fn said<'a>(&self, name: impl Fn(usize) -> &'a str) -> String {
        let Self { points, unseen, by_view } = self;
        if unseen == points || by_view.is_empty() {
            return self.unseen_said();
        }
        let mut sorted = by_view.clone();
        sorted.sort_unstable();
        let [least, median, most] = [0, sorted.len() / 2, sorted.len() - 1].map(|at| sorted[at]);
        let mut said = format!("photographs show {least} to {most} of the {points} points, {median} in the median");
        let blind: Vec<&str> = (0..by_view.len()).filter(|&view| by_view[view] == 0).map(&name).collect();
        if let Some(first) = blind.first() {
            said.push_str(&format!("; {} of {} show none, the first is {first}", blind.len(), by_view.len()));
        }
        if *unseen > 0 {
            said.push_str(&format!("; {}", self.unseen_said()));
        }
        said
    }

    /// How many points no photograph shows, and what that means where they are most.
    pub fn unseen_said(&self) -> String {
        let Self { points, unseen, .. } = self;
        if *unseen == 0 {
            return format!("photographs show all {points} points");
        }
        let why = if 2 * unseen > *points { format!(": {MISMATCH}") } else { String::new() };
        format!("no photograph shows {unseen} of the {points} points{why}")
    }
}

#[cfg(test)]
mod tests;
