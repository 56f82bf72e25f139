//! What the tracks of a reconstruction say of a camera: the directions in which it saw the sparse points.
//!
//! Photographs alone know poses up to a motion of everything, along which cameras drift while the scene is still a blur. Where
//! there are tracks, each camera is first set to where they put it (resection, by Gauss and Newton's method with robust
//! weights), and then held there by a weak pull. Directions, and not pixels, are compared, so that every lens and every size
//! of picture is alike.

use burn::tensor::{Device, Tensor, TensorData};
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};

use crate::capture::Capture;

/// Directions that miss by much less than this count by their square, by more in proportion, rad: about a pixel.
pub(in crate::effects) const ROBUST_RAD: f64 = 2e-3;

/// Rounds of the resection.
const ROUNDS: usize = 30;

/// Fewer points than this leave a camera where it is.
pub(in crate::effects) const FEWEST: usize = 8;

/// One photograph's points.
#[derive(Clone, Debug, Default)]
pub struct Anchors {
    /// World frame.
    points: Vec<DVec3>,
    /// Unit vectors, camera frame.
    directions: Vec<DVec3>,
}

/// Points and directions on the device, `[M, 3]` each.
pub(super) struct OnDevice {
    points: Tensor<2>,
    directions: Tensor<2>,
}

/// The anchors of some of a capture's photographs.
pub fn from_tracks(capture: &Capture, views: &[usize]) -> Vec<Anchors> {
    let mut place = vec![None; capture.views.len()];
    views.iter().enumerate().for_each(|(at, &view)| place[view] = Some(at));
    let mut anchors = vec![Anchors::default(); views.len()];
    for (point, position) in capture.points.positions.iter().enumerate() {
        let world = Vec3::from_array(*position).as_dvec3();
        for sight in capture.tracks.of(point) {
            let Some(place) = place[sight.view] else { continue };
            let at_px = Vec2::from_array(sight.at_px).as_dvec2();
            anchors[place].points.push(world);
            anchors[place].directions.push(capture.views[sight.view].intrinsics.cam_from_px(at_px).normalize());
        }
    }
    anchors
}

impl Anchors {
    /// The pose that explains the directions best, from a pose near it; the same where there are too few of them.
    pub fn resected(&self, cam_from_world: &DAffine3) -> DAffine3 {
        let mut pose = *cam_from_world;
        if self.points.len() < FEWEST {
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
        // Not to be worse off than before.
        if self.cost(&pose) < self.cost(cam_from_world) { pose } else { *cam_from_world }
    }

    fn cost(&self, pose: &DAffine3) -> f64 {
        let miss = |(point, direction): (&DVec3, &DVec3)| {
            let found = pose.transform_point3(*point).normalize_or_zero();
            found.distance_squared(*direction)
        };
        let robust = |squared: f64| (squared + ROBUST_RAD * ROBUST_RAD).sqrt();
        self.points.iter().zip(&self.directions).map(miss).map(robust).sum()
    }

    /// `ω` and `τ` of the next step: the least squares of `d + J (ω, τ) − d*` with `d = p/|p|` and the columns of `J` as in
    /// [`columns`], each weighted by what robustness leaves of it.
    fn step(&self, pose: &DAffine3) -> Option<[f64; 6]> {
        let mut gram = [[0.0; 6]; 6];
        let mut moment = [0.0; 6];
        for (point, direction) in self.points.iter().zip(&self.directions) {
            let cam = pose.transform_point3(*point);
            let length = cam.length();
            let found = cam / length;
            let residual = *direction - found;
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

    pub(super) fn on_device(&self, device: &Device) -> Option<OnDevice> {
        let count = self.points.len();
        let tensor = |rows: &[DVec3]| {
            let values: Vec<f32> = rows.iter().flat_map(|row| row.as_vec3().to_array()).collect();
            Tensor::<2>::from_data(TensorData::new(values, [count, 3]), device)
        };
        (count >= FEWEST).then(|| OnDevice { points: tensor(&self.points), directions: tensor(&self.directions) })
    }
}

impl OnDevice {
    /// Mean of `√(|d − d*|² + r²) − r`, about the angle between them in rad, `[1]`; `pose` is `[3, 4]`, tracked.
    pub fn penalty(&self, pose: Tensor<2>) -> Tensor<1> {
        let constant = |tensor: &Tensor<2>| Tensor::<2>::from_inner(tensor.clone());
        let turned = constant(&self.points).matmul(pose.clone().narrow(1, 0, 3).transpose());
        let cam = turned + pose.narrow(1, 3, 1).transpose();
        let length = cam.clone().square().sum_dim(1).clamp_min(1e-30).sqrt();
        let squared = (cam / length - constant(&self.directions)).square().sum_dim(1);
        (squared + ROBUST_RAD * ROBUST_RAD).sqrt().mean() - ROBUST_RAD
    }

    pub fn bytes(&self) -> usize {
        2 * self.points.shape().num_elements() * size_of::<f32>()
    }
}

/// How the direction in which a camera sees a point at `p`, in its frame, changes with its `ω` and `τ`: the columns of
/// `(I − d dᵀ)/|p| · [−p×, I]` with `d = p/|p|`.
pub(in crate::effects) fn columns(cam: DVec3) -> [DVec3; 6] {
    let length = cam.length();
    let direction = cam / length;
    let along = DMat3::from_cols(direction * direction.x, direction * direction.y, direction * direction.z);
    let tangent = (DMat3::IDENTITY - along) * (1.0 / length);
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    std::array::from_fn(|i| tangent * if i < 3 { axes[i].cross(cam) } else { axes[i - 3] })
}

/// Cayley's map of `ω/2`.
pub(super) fn rotation(omega: DVec3) -> DMat3 {
    let half = 0.5 * omega;
    let cross = DMat3::from_cols(
        DVec3::new(0.0, half.z, -half.y),
        DVec3::new(-half.z, 0.0, half.x),
        DVec3::new(half.y, -half.x, 0.0),
    );
    DMat3::IDENTITY + (cross + cross * cross) * (2.0 / (1.0 + half.length_squared()))
}

/// `x` of `gram x = moment` for a symmetric positive definite matrix, by elimination; none if it is singular.
pub(in crate::effects) fn solve(mut gram: [[f64; 6]; 6], mut moment: [f64; 6]) -> Option<[f64; 6]> {
    let largest = (0..6).map(|i| gram[i][i]).fold(0.0, f64::max);
    for step in 0..6 {
        if !(gram[step][step] > 1e-14 * largest) {
            return None;
        }
        for row in step + 1..6 {
            let factor = gram[row][step] / gram[step][step];
            (step..6).for_each(|column| gram[row][column] -= factor * gram[step][column]);
            moment[row] -= factor * moment[step];
        }
    }
    for row in (0..6).rev() {
        let known: f64 = (row + 1..6).map(|column| gram[row][column] * moment[column]).sum();
        moment[row] = (moment[row] - known) / gram[row][row];
    }
    Some(moment)
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    /// Points before a camera, in directions that are a little off if asked for, and the camera's pose.
    fn sights(count: usize, noise: f64) -> (Anchors, DAffine3) {
        let pose = DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.7), DVec3::new(0.3, -0.2, 2.0));
        let spread = |i: usize, by: f64| (by * i as f64).sin();
        let mut anchors = Anchors::default();
        for i in 0..count {
            let cam = DVec3::new(1.5 * spread(i, 1.3), 1.2 * spread(i, 2.1), 4.0 + 2.0 * spread(i, 0.7));
            let seen = cam.normalize() + noise * DVec3::new(spread(i, 5.1), spread(i, 7.7), 0.0);
            anchors.points.push(pose.inverse().transform_point3(cam));
            anchors.directions.push(seen.normalize());
        }
        (anchors, pose)
    }

    fn wrong(pose: &DAffine3) -> DAffine3 {
        DAffine3::from_translation(DVec3::new(0.1, -0.05, 0.08)) * DAffine3::from_axis_angle(DVec3::X, 0.05) * *pose
    }

    #[test]
    fn a_camera_is_put_where_its_points_say() {
        let (anchors, pose) = sights(40, 0.0);
        assert!(anchors.resected(&wrong(&pose)).abs_diff_eq(pose, 1e-9));
        // A fifth of the directions is nonsense.
        let (mut anchors, pose) = sights(100, 1e-4);
        for i in (0..100).step_by(5) {
            anchors.directions[i] = (anchors.directions[i] + DVec3::new(0.2, 0.1, 0.0)).normalize();
        }
        let found = anchors.resected(&wrong(&pose));
        assert!(found.abs_diff_eq(pose, 3e-3), "{found:?} instead of {pose:?}");
        // Too little to go by.
        let (few, pose) = sights(FEWEST - 1, 0.0);
        assert_eq!(few.resected(&wrong(&pose)), wrong(&pose));
        assert!(few.on_device(&Device::flex()).is_none());
    }

    #[test]
    fn columns_are_the_derivative_of_directions() {
        let cam = DVec3::new(0.7, -0.4, 2.5);
        let step = 1e-6;
        for (i, column) in columns(cam).into_iter().enumerate() {
            let axis = [DVec3::X, DVec3::Y, DVec3::Z][i % 3] * step;
            let moved = |sign: f64| if i < 3 { cam + sign * axis.cross(cam) } else { cam + sign * axis };
            let expected = (moved(1.0).normalize() - moved(-1.0).normalize()) / (2.0 * step);
            assert!(column.distance(expected) < 1e-9, "{i}: {column} instead of {expected}");
        }
    }

    #[test]
    fn the_pull_is_an_angle_and_vanishes_at_the_right_pose() {
        let device = Device::flex();
        let (anchors, pose) = sights(40, 0.0);
        let on_device = anchors.on_device(&device).unwrap();
        let penalty = |pose: &DAffine3| {
            let rows: Vec<f32> = (0..3)
                .flat_map(|i| [pose.x_axis[i], pose.y_axis[i], pose.z_axis[i], pose.translation[i]])
                .map(|value| value as f32)
                .collect();
            let pose = Tensor::<2>::from_data(TensorData::new(rows, [3, 4]), &device);
            on_device.penalty(Tensor::from_inner(pose)).into_scalar::<f32>()
        };
        assert!(penalty(&pose).abs() < 1e-6);
        // Turned about the axis of view by 0.03 rad: each direction by that times its distance from the axis.
        let turned = DAffine3::from_mat3(rotation(DVec3::new(0.0, 0.0, 0.03))) * pose;
        let miss = |direction: &DVec3| (0.03 * direction.truncate().length()).hypot(ROBUST_RAD) - ROBUST_RAD;
        let expected = anchors.directions.iter().map(miss).sum::<f64>() / 40.0;
        assert!((f64::from(penalty(&turned)) - expected).abs() < 0.01 * expected);
        assert_eq!(on_device.bytes(), 2 * 40 * 12);
    }
}
