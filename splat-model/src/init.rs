//! The initial Gaussians of a scene: from a sparse point cloud, from points that photographs show, or random.

mod matching;

use std::collections::HashSet;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use splat_op::Intrinsics;

pub use self::matching::matched_points;
use crate::capture::PointCloud;
use crate::capture::spread::Spread;
use crate::cleanup::Bulk;
use crate::density::morton_order;
use crate::gaussians::{DC, GaussianRows};
use crate::optim::scene_extent;

/// Minimum initial value of a colour channel: half a level of 255.
const DARKEST: f32 = 0.5 / 255.0;

/// Initial opacity of a Gaussian (Kerbl et al. 2023, section 5.1, the value of their code).
pub const START_OPACITY: f32 = 0.1;

/// Number of neighbours whose root mean square distance is the initial standard deviation (Kerbl et al. 2023, section 5.1).
const NEIGHBOURS: usize = 3;

/// Minimum squared distance, as in the original code; without it, points at one place would have no size. For a cloud less than
/// a unit across, the minimum is this share of its squared size, so that a small scene starts like a large one.
const SMALLEST_SQUARED_DISTANCE: f32 = 1e-7;

/// Distance of two points at one place, relative to the size of the cloud: some roundings of f32. A ten-thousandth would take 15% of the points of
/// `bonsai`, which no others replace.
const SAME_PLACE: f64 = 1e-5;

/// Number of random Gaussians for a start without points.
pub const RANDOM_COUNT: usize = 20_000;

/// Largest number of points that a start takes from photographs, and the pixels of all photographs for each.
const MATCHED_COUNT: usize = 15_000;
const PIXELS_EACH: usize = 50;

/// Points are few if they are fewer than one in so many of what photographs may give.
const FEW_IN: usize = 3;

/// The number of points to take from photographs with so many pixels together ([`matched_points`]) beside these: none if there are enough.
pub fn missing(points: usize, pixels: usize) -> usize {
    let wanted = MATCHED_COUNT.min(pixels / PIXELS_EACH);
    if FEW_IN * points < wanted { wanted - points } else { 0 }
}

/// Returns one round Gaussian per point. Its standard deviation is the root mean square distance to the three nearest
/// neighbours, its opacity 0.1, its colour the point's colour without view dependence.
pub fn from_points(points: &PointCloud) -> GaussianRows {
    let squared = neighbour_distances(&points.positions);
    let across = size_of_cloud(&points.positions) as f32;
    // Points at one place do not give the size of the scene.
    let floor = SMALLEST_SQUARED_DISTANCE * if across > 0.0 && across < 1.0 { across * across } else { 1.0 };
    let count = points.positions.len();
    let logit = (START_OPACITY / (1.0 - START_OPACITY)).ln();
    // Colours start slightly above black, where they would be clamped and have no gradient.
    let dc = |colour: &[u8; 3]| colour.map(|channel| ((f32::from(channel) / 255.0).max(DARKEST) - 0.5) / DC as f32);
    GaussianRows {
        means: points.positions.clone(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: squared.iter().map(|d| [0.5 * d.max(floor).ln(); 3]).collect(),
        logit_opacities: vec![logit; count],
        sh_dc: points.colours.iter().map(dc).collect(),
        ..GaussianRows::default()
    }
}

/// The longest side of the box around the [bulk](Bulk) of the points; 0 without points.
fn size_of_cloud(positions: &[[f32; 3]]) -> f64 {
    Bulk::of(positions).map_or(0.0, |bulk| bulk.width)
}

/// Returns the points that are at places of their own: of those at one place, to 1e-5 of the cloud's size, the first. Merged
/// clouds hold points several times, with coordinates that were rounded on the way. Positions that are not finite are left out.
pub fn distinct(points: &PointCloud) -> PointCloud {
    let finite = |row: &usize| points.positions[*row].iter().all(|coordinate| coordinate.is_finite());
    let rows = || (0..points.positions.len()).filter(finite);
    let positions: Vec<[f32; 3]> = rows().map(|row| points.positions[row]).collect();
    let near = match SAME_PLACE * size_of_cloud(&positions) {
        near if near > 0.0 => near,
        _ => f64::from(f32::MIN_POSITIVE),
    };
    let cell = |position: &[f32; 3], corner: [f64; 3]| {
        [0, 1, 2].map(|axis| ((f64::from(position[axis]) + near * corner[axis]) / (4.0 * near)).floor().to_bits())
    };
    let mut taken = HashSet::with_capacity(positions.len());
    let is_new = |row: &usize| {
        let position = &points.positions[*row];
        // The cell of a point at most `near` away is that of a corner of this box, because cells are larger.
        let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { -1.0 } else { 1.0 });
        !(0..8).any(|i| taken.contains(&cell(position, corner(i)))) && taken.insert(cell(position, [0.0; 3]))
    };
    points.picked(rows().filter(is_new))
}

/// Mean squared distance of each point to its three nearest neighbours, or to all other points if they are fewer.
fn neighbour_distances(positions: &[[f32; 3]]) -> Vec<f32> {
    if positions.len() < 2 {
        return vec![1.0; positions.len()];
    }
    let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(positions);
    let wanted = std::num::NonZero::new(NEIGHBOURS + 1).expect("one more than three");
    let mean = |position: &[f32; 3]| {
        // The nearest is the point itself.
        let others = &tree.nearest_n::<SquaredEuclidean>(position, wanted)[1..];
        others.iter().map(|neighbour| neighbour.distance).sum::<f32>() / others.len() as f32
    };
    positions.par_iter().map(mean).collect()
}

/// Returns random points of random colour in the volume that all cameras look at. Each point lies in the picture of a random
/// camera, at a depth between 0.5 and 1.5 times the camera's distance to the point nearest to all optical axes (a distance, not
/// a depth, for a fisheye). For a camera at that point, as in a panorama, the scene extent replaces the distance. Strays among the
/// cameras (see [`scene_extent`]) do not count.
pub fn random_points(cameras: &[(Intrinsics, DAffine3)], count: usize, rng: &mut impl Rng) -> PointCloud {
    let mut points = PointCloud::default();
    let poses: Vec<DAffine3> = cameras.iter().map(|(_, pose)| pose.inverse()).collect();
    let Some((focus, extent, usual)) = focus_of(&poses) else { return points };
    for _ in 0..count {
        let view = usual[rng.random_range(0..usual.len())];
        let ((camera, _), world_from_cam) = (&cameras[view], &poses[view]);
        let distance = distance_to(focus, world_from_cam, extent);
        let depth = distance * rng.random_range(0.5..1.5);
        let px = DVec2::new(rng.random_range(0.0..camera.width as f64), rng.random_range(0.0..camera.height as f64));
        points.positions.push(world_from_cam.transform_point3(camera.cam_from_px(px) * depth).as_vec3().to_array());
        points.colours.push([rng.random(), rng.random(), rng.random()]);
    }
    points
}

/// The point that cameras of these poses, `world_from_cam`, look at, the scene extent, and which of them are no strays, which do not count.
/// `None` without a camera.
fn focus_of(poses: &[DAffine3]) -> Option<(DVec3, f64, Vec<usize>)> {
    let centres: Vec<DVec3> = poses.iter().map(|pose| pose.translation).collect();
    let spread = Spread::of(&centres)?;
    let usual: Vec<usize> = (0..poses.len()).filter(|&view| spread.holds(centres[view])).collect();
    let poses: Vec<DAffine3> = usual.iter().map(|&view| poses[view]).collect();
    // Of cameras that all look the same way, the point one unit ahead of their mean.
    let ahead = || poses.iter().map(|pose| pose.translation + pose.matrix3.z_axis).sum::<DVec3>() / poses.len() as f64;
    Some((focus(&poses).unwrap_or_else(ahead), scene_extent(&centres), usual))
}

/// The distance of the point that all cameras look at from one of them; the scene extent for a camera at that point, as in a panorama.
fn distance_to(focus: DVec3, world_from_cam: &DAffine3, extent: f64) -> f64 {
    let distance = (focus - world_from_cam.translation).length();
    // The focus is computed, so a zero distance may appear as a rounding error.
    if distance > 1e-6 * extent { distance } else { extent }
}

/// Returns the point with the smallest sum of squared distances to the optical axes of cameras of these poses, `world_from_cam`;
/// `None` where the axes are parallel.
pub fn focus(poses: &[DAffine3]) -> Option<DVec3> {
    let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for pose in poses {
        let axis = pose.matrix3.z_axis;
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        normal += across;
        right += across * pose.translation;
    }
    (normal.determinant() > 1e-6 * (poses.len() as f64).powi(3)).then(|| normal.inverse() * right)
}

/// Returns the points in Morton order, so that neighbours are next to each other (see [`morton_order`]).
pub fn ordered(points: &PointCloud) -> PointCloud {
    points.picked(morton_order(&points.positions).iter().map(|&row| row as usize))
}

/// Returns the whole cloud, or every `k`th of its points if it holds more than `most`.
pub fn thinned(points: &PointCloud, most: usize) -> PointCloud {
    let count = points.positions.len();
    points.picked((0..count).step_by(count.div_ceil(most.max(1)).max(1)))
}

#[cfg(test)]
mod tests;
