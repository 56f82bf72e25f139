//! Random Gaussians of all kinds, seen by cameras with every lens, and how far each kind may deviate.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::cpu::project_cpu;
use super::{COLUMNS, COMPENSATION_MIN, Geometry, ProjectSpec};
use crate::camera::{CameraModel, Intrinsics};
use crate::gpu::{Buffer, Gpu};
use crate::options::RenderOptions;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::random::Random;

pub(super) const ALL: Geometry<bool> =
    Geometry { means: true, rotations: true, scales: true, opacities: true, cam_from_world: true, mean2d: true };
pub(super) const NAMES: [&str; 6] = ["means", "rotations", "scales", "opacities", "pose", "mean2d"];

// Classes of Gaussians. The Gaussians of the first two classes are well-conditioned.
pub(super) const CULLED: u8 = 0;
pub(super) const ORDINARY: u8 = 1;
pub(super) const NEEDLE: u8 = 2;
pub(super) const NEAR: u8 = 3;
pub(super) const HUGE: u8 = 4;
pub(super) const TINY: u8 = 5;
pub(super) const SHORT_QUATERNION: u8 = 6;
pub(super) const LONG_QUATERNION: u8 = 7;

/// Camera, pose and options.
pub(super) struct TestCamera {
    pub pose: Vec<f64>,
    /// Width and height, px.
    pub size: [usize; 2],
    pub model: CameraModel,
    /// fx, fy, cx and cy, px, and the eight coefficients of the model.
    pub lens: Vec<f64>,
    pub options: RenderOptions,
}

impl TestCamera {
    /// Camera 0 is at the origin, with its principal point at the centre of the picture. Camera 1 is rotated and moved, and its
    /// principal point is off centre. The matrix of camera 2 is not a rotation, and its principal point lies outside the picture.
    pub fn new(which: usize, blur: f64, antialias: bool) -> Self {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.4, -0.3, 0.2, 0.8).normalize());
        let (matrix, translation, lens, near) = match which {
            0 => (DMat3::IDENTITY, DVec3::ZERO, [50.0, 50.0, 32.0, 24.0], 0.01),
            1 => (turn, DVec3::new(3.0, -2.0, 5.0), [61.0, 43.0, 41.5, 13.25], 0.5),
            _ => {
                let bend = DMat3::from_cols_array(&[1.1, 0.05, -0.04, 0.02, 0.9, 0.06, -0.03, 0.07, 1.05]);
                (bend * turn, DVec3::new(-40.0, 10.0, 2.0), [47.0, 55.0, -9.5, 60.0], 0.2)
            }
        };
        let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis, translation];
        let pose: Vec<f64> = (0..3).flat_map(|row| columns.map(|column| column[row])).collect();
        let options = RenderOptions { blur: f64::from(blur as f32), antialias, ..RenderOptions::standard() };
        let options = RenderOptions { near: f64::from(near as f32), ..options };
        let lens = rounded(&[&lens[..], &[0.0; 8]].concat());
        Self { pose: rounded(&pose), size: [64, 48], model: CameraModel::Pinhole, lens, options }
    }

    pub fn with_lens(mut self, (model, distortion): (CameraModel, [f64; 8])) -> Self {
        self.model = model;
        self.lens[4..].copy_from_slice(&rounded(&distortion));
        self
    }

    pub fn spec(&self, lens: &[f64]) -> ProjectSpec {
        let ([width, height], [fx, fy, cx, cy]) = (self.size, [lens[0], lens[1], lens[2], lens[3]]);
        let distortion = std::array::from_fn(|i| lens[4 + i]);
        let intrinsics = Intrinsics { model: self.model, distortion, width, height, fx, fy, cx, cy };
        ProjectSpec { intrinsics, options: self.options, factors: false }
    }

    /// Limits to which the Jacobian's slopes are clamped: low and high along x, then along y.
    pub fn limits(&self, lens: &[f64]) -> [f64; 4] {
        let [[low_x, high_x], [low_y, high_y]] = self.spec(lens).intrinsics.slope_limits(self.options.jacobian_margin);
        [low_x, high_x, low_y, high_y]
    }
}

/// Means, rotations, scales, opacities, pose, lens and gradient, all in f32 precision, and the kind of each Gaussian.
pub(super) struct StageInputs {
    pub tensors: Vec<Vec<f64>>,
    pub kinds: Vec<u8>,
}

pub(super) const POSE: usize = 4;
pub(super) const LENS: usize = 5;
pub(super) const GRAD: usize = 6;

pub(super) fn inputs<F>(tensors: &[Vec<F>]) -> Geometry<&'_ [F]> {
    let [means, rotations, scales, opacities, cam_from_world, ..] = tensors else { unreachable!("five tensors") };
    Geometry { means, rotations, scales, opacities, cam_from_world, mean2d: &[] }
}

impl StageInputs {
    /// Gaussians in view, outside it and behind the camera, with invalid values, and without a gradient; extreme ones too if `wild`.
    pub fn random(seed: u64, count: usize, view: &TestCamera, wild: bool) -> Self {
        let mut random = Random::new(seed);
        let p = &view.pose;
        let column = |c: usize| DVec3::new(p[c], p[4 + c], p[8 + c]);
        let pose = DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) };
        let [low_x, high_x, low_y, high_y] = view.limits(&view.lens);
        let mut tensors = vec![Vec::new(); 4];
        let mut grad = random.fill(count * COLUMNS, -1.0, 1.0);
        let mut kinds = Vec::new();
        for i in 0..count {
            let mut kind = ORDINARY;
            let mut z = random.between(0.6, 9.0);
            let mut slopes = [random.between(low_x, high_x), random.between(low_y, high_y)];
            let mut scale = [(); 3].map(|()| random.between(-4.0, -0.5).exp());
            let mut rotation = [(); 4].map(|()| random.between(-1.5, 1.5));
            let mut bad = f64::NAN;
            match (i % 16, wild) {
                (1, _) => slopes[i / 16 % 2] += [3.0, -3.0][i / 32 % 2],
                (3, _) => z = -z,
                (5, _) => scale = [(); 3].map(|()| random.between(1e-4, 4e-4)),
                (7, _) => {
                    // Keeps at most one element of the gradient.
                    let row = grad[COLUMNS * i..COLUMNS * (i + 1)].iter_mut().enumerate();
                    row.filter(|(column, _)| *column != i / 16 % 8).for_each(|(_, grad)| *grad = 0.0);
                }
                (9, _) => bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][i / 16 % 3],
                (11, _) => rotation = [0.0; 4],
                (15, _) => scale = [scale[0]; 3],
                (2, true) => (kind, scale) = (NEEDLE, [1.0, 1e-3, 1e-3]),
                (4, true) => (kind, z) = (NEAR, view.options.near * random.between(0.5, 2.0)),
                (6, true) => (kind, scale) = (HUGE, [50.0, 49.0, 48.0].map(f64::exp)),
                (8, true) => (kind, scale) = (TINY, [-50.0, -49.0, -48.0].map(f64::exp)),
                (10, true) => (kind, scale[i / 16 % 3]) = (HUGE, 50.0_f64.exp()),
                (12, true) => (kind, scale[i / 16 % 3]) = (NEEDLE, (-50.0_f64).exp()),
                (13, true) => (kind, rotation) = (SHORT_QUATERNION, rotation.map(|q| 1e-20 * q)),
                (14, true) => (kind, rotation) = (LONG_QUATERNION, rotation.map(|q| 1e20 * q)),
                _ => {}
            }
            let mean = pose.inverse().transform_point3(DVec3::new(slopes[0] * z, slopes[1] * z, z));
            tensors[0].extend(mean.to_array());
            tensors[1].extend(rotation);
            tensors[2].extend(scale);
            tensors[3].push(random.between(0.1, 1.0));
            if i % 16 == 9 {
                let tensor = i / 16 % 4;
                let last = tensors[tensor].len() - 1 - if tensor == 3 { 0 } else { i / 64 % 3 };
                tensors[tensor][last] = bad;
            }
            kinds.push(kind);
        }
        tensors.extend([view.pose.clone(), view.lens.clone(), grad]);
        Self { tensors: tensors.iter().map(|tensor| rounded(tensor)).collect(), kinds }
    }

    pub fn count(&self) -> usize {
        self.kinds.len()
    }

    pub fn upload(&self, gpu: &Gpu) -> (Geometry<Buffer<f32>>, Buffer<f32>) {
        let buffer = |i: usize| Buffer::from_slice(gpu, &to_f32(&self.tensors[i]));
        let inputs = Geometry {
            means: buffer(0),
            rotations: buffer(1),
            scales: buffer(2),
            opacities: buffer(3),
            cam_from_world: buffer(POSE),
            mean2d: Buffer::new(gpu, 0),
        };
        (inputs, buffer(GRAD))
    }

    /// Class of each Gaussian. The band contains Gaussians that are culled or not depending on rounding and, for the backward pass,
    /// those that rounding may move across a limit of the Jacobian or the lower limit of the compensation.
    pub fn classes(&self, view: &TestCamera, backward: bool) -> Vec<Option<u8>> {
        let spec = view.spec(&view.lens);
        let margins = PerturbedReference::new(&self.tensors, |tensors| margins(tensors, view));
        let (cull, rest) = (margins.near_zero(0), margins.near_zero(1));
        let cull: Vec<bool> = cull.chunks_exact(2).map(|pair| pair.contains(&true)).collect();
        let seen: Vec<bool> =
            project_cpu(inputs(&self.tensors), &spec).chunks_exact(COLUMNS).map(|row| row[5] > 0.0).collect();
        let class = |i: usize| {
            let jumps = cull[i] || (backward && seen[i] && rest[5 * i..5 * (i + 1)].contains(&true));
            (!jumps).then(|| if seen[i] { self.kinds[i] } else { CULLED })
        };
        let classes: Vec<_> = (0..self.count()).map(class).collect();
        let band = classes.iter().filter(|class| class.is_none()).count();
        assert!(band <= 1 + self.count() / 100, "{band} of {} Gaussians in the band", self.count());
        classes
    }
}

/// Relative distances from the thresholds: `[N, 2]` from the near plane and the radius of the lens's domain; `[N, 5]` from the limits
/// of the Jacobian and from the lower limit of the compensation, which is the ratio of the ellipse's area without blur to that with
/// it.
pub(super) fn margins(tensors: &[Vec<f64>], view: &TestCamera) -> Vec<Vec<f64>> {
    let (p, limits) = (&tensors[POSE], view.limits(&tensors[LENS]));
    let mut spec = view.spec(&tensors[LENS]);
    let area = |spec: &ProjectSpec| -> Vec<f64> {
        project_cpu(inputs(tensors), spec).chunks_exact(COLUMNS).map(|row| row[2] * row[4]).collect()
    };
    let blurred = area(&spec);
    spec.options.blur = 0.0;
    let areas = area(&spec);
    let (mut near, mut rest) = (Vec::new(), Vec::new());
    for (i, m) in tensors[0].chunks_exact(3).enumerate() {
        let along = |row: usize| (0..3).map(|k| p[4 * row + k] * m[k]).sum::<f64>() + p[4 * row + 3];
        let (x, y, z) = (along(0), along(1), along(2));
        let slope = (x / z).hypot(y / z);
        let (fisheye, max_radius) = (view.model.is_fisheye(), spec.intrinsics.max_radius());
        near.extend([z / view.options.near - 1.0, if fisheye { slope.atan() } else { slope } / max_radius - 1.0]);
        let clamped = !fisheye && view.model != CameraModel::Orthographic;
        let slopes = if clamped { [x / z, x / z, y / z, y / z] } else { [f64::NAN; 4] };
        rest.extend(slopes.iter().zip(limits).map(|(slope, limit)| (slope - limit) / (1.0 + limit.abs())));
        rest.push(if view.options.antialias { areas[i] / blurred[i] / COMPENSATION_MIN - 1.0 } else { f64::NAN });
    }
    vec![near, rest]
}

pub(super) fn list(g: Geometry<Vec<f64>>) -> Vec<Vec<f64>> {
    vec![g.means, g.rotations, g.scales, g.opacities, g.cam_from_world, g.mean2d]
}

pub(super) fn read(gpu: &Gpu, g: &Geometry<Option<Buffer<f32>>>) -> [Option<Vec<f32>>; 6] {
    [&g.means, &g.rotations, &g.scales, &g.opacities, &g.cam_from_world, &g.mean2d]
        .map(|buffer| buffer.as_ref().map(|buffer| buffer.read(gpu)))
}
