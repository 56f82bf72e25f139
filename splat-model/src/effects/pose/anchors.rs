//! Constraints on a camera from the tracks of a reconstruction: the directions in which it observed the sparse points.
//!
//! Photographs alone determine poses only up to a motion of scene and cameras together, along which cameras drift while the scene is still
//! blurred. Where there are tracks, each camera is first placed by them (resection, by the Gauss-Newton method with robust weights) and
//! then held there by a weak penalty. The method compares directions instead of pixels, so that it works for every lens and image size.

use burn::tensor::{Device, Tensor, TensorData};
use glam::{DAffine3, DMat3, DVec3, Vec2};
use splat_op::pose::miss;

use crate::capture::Capture;
use crate::solve::solve;

/// Scale of the robust loss, rad: errors well below it count by their square, larger errors linearly. About a pixel.
pub(in crate::effects) const ROBUST_RAD: f64 = 2e-3;

/// Largest number of iterations of the resection.
const ROUNDS: usize = 30;

/// Smallest number of points for a resection. A camera with fewer is not moved.
pub(in crate::effects) const FEWEST: usize = 8;

/// The observed points of one photograph: positions, world frame, and unit vectors to them, camera frame.
#[derive(Clone, Debug, Default)]
pub struct Anchors(Vec<(DVec3, DVec3)>);

/// Collects the anchors of the photographs `views` of a capture.
pub fn from_tracks(capture: &Capture, views: &[usize]) -> Vec<Anchors> {
    let lists = capture.by_view(views.iter().copied(), |view, world, observation| {
        Some((world, view.intrinsics.cam_from_px(Vec2::from_array(observation.at_px).as_dvec2()).normalize()))
    });
    lists.into_iter().map(Anchors).collect()
}

impl Anchors {
    /// The pose that fits the directions best, starting from `cam_from_world`. Returns `cam_from_world` if there are too few points.
    pub fn resected(&self, cam_from_world: &DAffine3) -> DAffine3 {
        let mut pose = *cam_from_world;
        if self.0.len() < FEWEST {
            return pose;
        }
        for _ in 0..ROUNDS {
            let Some(step) = self.step(&pose) else { break };
            let (turn, shift) = (DVec3::from_slice(&step[..3]), DVec3::from_slice(&step[3..]));
            pose = DAffine3::from_translation(shift) * DAffine3::from_mat3(rotation(turn)) * pose;
            if step.iter().all(|value| value.abs() < 1e-12) {
                break;
            }
        }
        // Never returns a pose that fits worse than the given one.
        if self.cost(&pose) < self.cost(cam_from_world) { pose } else { *cam_from_world }
    }

    fn cost(&self, pose: &DAffine3) -> f64 {
        let miss = |&(point, direction): &(DVec3, DVec3)| {
            pose.transform_point3(point).normalize_or_zero().distance_squared(direction)
        };
        let robust = |squared: f64| (squared + ROBUST_RAD * ROBUST_RAD).sqrt();
        self.0.iter().map(miss).map(robust).sum()
    }

    /// The next Gauss-Newton step, `ω` and `τ`: the least-squares solution for `d + J (ω, τ) − d*` with `d = p/|p|` and the
    /// columns of `J` as in [`columns`], with robust weights.
    fn step(&self, pose: &DAffine3) -> Option<[f64; 6]> {
        let mut gram = [[0.0; 6]; 6];
        let mut moment = [0.0; 6];
        for &(point, direction) in &self.0 {
            let cam = pose.transform_point3(point);
            let residual = direction - cam / cam.length();
            if !residual.is_finite() {
                continue;
            }
            let weight = 1.0 / (residual.length_squared() + ROBUST_RAD * ROBUST_RAD).sqrt();
            let columns = columns(cam);
            for row in 0..6 {
                (0..6).for_each(|column| gram[row][column] += weight * columns[row].dot(columns[column]));
                moment[row] += weight * columns[row].dot(residual);
            }
        }
        solve(gram, moment)
    }

    /// Points and directions, `[M, 3]` each.
    pub(super) fn on_device(&self, device: &Device) -> Option<[Tensor<2>; 2]> {
        let count = self.0.len();
        let tensor = |of: fn(&(DVec3, DVec3)) -> DVec3| {
            let values: Vec<f32> = self.0.iter().flat_map(|pair| of(pair).as_vec3().to_array()).collect();
            Tensor::<2>::from_data(TensorData::new(values, [count, 3]), device)
        };
        (count >= FEWEST).then(|| [tensor(|pair| pair.0), tensor(|pair| pair.1)])
    }
}

/// The miss of `pose`, `[3, 4]`, tracked, as `[1]`: about the mean angle between the directions to points and the observed ones, rad.
pub(super) fn penalty([points, directions]: &[Tensor<2>; 2], pose: &Tensor<2>) -> Tensor<1> {
    miss(pose, points, directions, ROBUST_RAD).expect("points and poses on one device")
}

/// Derivative of the direction to a point `p`, camera frame, with respect to the camera's `ω` and `τ`: the columns of
/// `(I − d dᵀ)/|p| · [−p×, I]` with `d = p/|p|`.
pub(in crate::effects) fn columns(cam: DVec3) -> [DVec3; 6] {
    let moved = |i: usize| if i < 3 { DVec3::AXES[i].cross(cam) } else { DVec3::AXES[i - 3] };
    std::array::from_fn(|i| moved(i).reject_from(cam) / cam.length())
}

/// The Cayley map of `ω/2`.
pub(super) fn rotation(omega: DVec3) -> DMat3 {
    let half = 0.5 * omega;
    let cross = DMat3::from_cols(
        DVec3::new(0.0, half.z, -half.y),
        DVec3::new(-half.z, 0.0, half.x),
        DVec3::new(half.y, -half.x, 0.0),
    );
    DMat3::IDENTITY + (cross + cross * cross) * (2.0 / (1.0 + half.length_squared()))
}

#[cfg(test)]
mod tests;
