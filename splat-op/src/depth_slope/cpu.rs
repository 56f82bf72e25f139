//! The CPU twin of `depth_slope`: both passes, generic over the float, parallel over chunks of Gaussians.

use rayon::prelude::*;

use super::{DEPTH_SLOPE, LENS_FRAME, THICKNESS_MAX, columns};
use crate::linalg::{
    Mat3, add, cross, dot, hadamard, matmul, matvec, norm, rotation_of, scale, sub, transpose, transposed_matvec,
};
use crate::project::cpu::zero_grads;
use crate::project::lens_jacobian::LensJacobian;
use crate::project::simd::ProjectCameraSimd;
use crate::project::{Geometry, ProjectSpec};
use crate::simd::real::Real;

/// Number of Gaussians per task. The pose's gradient adds one partial sum per chunk, in order.
const CHUNK: usize = 1024;

/// Intermediate results of the forward pass, with the names of the module's documentation.
struct DepthSlopeTermsCpu<F> {
    mean_cam: [F; 3],
    ratio: [F; 2],
    slope: [F; 2],
    slope_free: [bool; 2],
    quaternion: [F; 4],
    quaternion_length: F,
    world_from_gaussian: Mat3<F>,
    /// `W R`
    cam_from_gaussian: Mat3<F>,
    /// Jacobian of the lens, if there is one.
    bent: Option<LensJacobian<F>>,
    /// `j`: the rows of `J W R`, and the last row of `W R` over z; `m`: the rows of `j` times the scales.
    j: Mat3<F>,
    m: Mat3<F>,
    sigma_u: F,
    sigma_v: F,
    n: [F; 3],
    b_u: F,
    p: [F; 3],
    a: [F; 3],
    b: F,
    /// `m1 / sigma_u`.
    along: [F; 3],
    depth_slope: [F; DEPTH_SLOPE],
    thickness_free: bool,
    /// False if the Gaussian is too long for a depth slope.
    sound: bool,
}

impl<F: Real> DepthSlopeTermsCpu<F> {
    /// Returns `None` for a Gaussian that `project` culls.
    fn new(lens: &ProjectCameraSimd<F>, inputs: &Geometry<&[F]>, i: usize) -> Option<Self> {
        let three = |values: &[F]| [values[3 * i], values[3 * i + 1], values[3 * i + 2]];
        let (mean, scales) = (three(inputs.means), three(inputs.scales));
        let rotation: [F; 4] = std::array::from_fn(|k| inputs.rotations[4 * i + k]);
        let mean_cam = add(matvec(&lens.rotation, mean), lens.translation);
        let z = mean_cam[2];
        let largest = rotation.iter().fold(F::ZERO, |largest, c| largest.max_of(c.abs()));
        if !(z > F::ZERO && z > lens.near && largest > F::ZERO) {
            return None;
        }
        let unit = rotation.map(|c| c / largest);
        let length = unit.iter().map(|c| *c * *c).sum::<F>().sqrt();
        let quaternion = unit.map(|c| c / length);
        let world_from_gaussian = rotation_of(F::ONE, quaternion);
        let cam_from_gaussian = matmul(&lens.rotation, &world_from_gaussian);
        let last = cam_from_gaussian[2];

        let ratio = [mean_cam[0] / z, mean_cam[1] / z];
        let slope: [F; 2] = std::array::from_fn(|axis| ratio[axis].within(lens.low[axis], lens.high[axis]));
        let bent = lens.lens_jacobian(mean_cam);
        if lens.bends() && bent.is_none() {
            return None;
        }
        let row = |axis: usize| match &bent {
            Some(jacobian) => transposed_matvec(&cam_from_gaussian, jacobian[axis]),
            None => scale(sub(cam_from_gaussian[axis], scale(last, slope[axis])), lens.focal[axis] / z),
        };
        let j = [row(0), row(1), scale(last, F::ONE / z)];
        let m = j.map(|row| hadamard(row, scales));
        let [m0, m1, mz] = m;
        let sigma_u = norm([norm(m0), lens.blur_sigma, F::ZERO]);
        let n = scale(m0, F::ONE / sigma_u);
        let along = scale(m1, F::ONE / sigma_u);
        let across = cross(n, m1);
        let sigma_v = norm([norm(across), lens.blur_sigma, lens.blur_sigma * norm(along)]);
        let (b_u, b) = (lens.blur_sigma / sigma_u, lens.blur_sigma / sigma_v);
        let (p, a) = (scale(across, F::ONE / sigma_v), scale(along, b));

        let c = cross(n, mz);
        let thickness = norm([norm([dot(mz, p), b * norm(c), F::ZERO]), norm(cross(a, mz)), b * b_u * norm(mz)]);
        let held = thickness.min_of(F::of(THICKNESS_MAX));
        let depth_slope = [dot(mz, n), dot(p, c) + b_u * dot(a, mz), held];
        let sound = norm(mz) <= F::of(1e30) && depth_slope.iter().all(|value| value.finite());
        Some(Self {
            mean_cam,
            ratio,
            slope,
            slope_free: std::array::from_fn(|axis| slope[axis] == ratio[axis]),
            quaternion,
            quaternion_length: length * largest,
            world_from_gaussian,
            cam_from_gaussian,
            bent,
            j,
            m,
            sigma_u,
            sigma_v,
            n,
            b_u,
            p,
            a,
            b,
            along,
            depth_slope,
            thickness_free: held == thickness,
            sound,
        })
    }

    /// Returns the columns of a lens.
    fn frame(&self) -> Option<[F; LENS_FRAME]> {
        let ([[a, b, _], [c, d, _]], z) = (self.bent?, self.mean_cam[2]);
        Some([self.ratio[0], self.ratio[1], z * a, z * b, z * c, z * d])
    }

    /// Returns the gradients of the rows of `m` from the gradient of the depth slope.
    fn factor_backward(&self, [grad_u, grad_v, grad_thickness]: [F; DEPTH_SLOPE]) -> Mat3<F> {
        let Self { n, b_u, p, a, b, along, .. } = *self;
        let (m1, mz) = (self.m[1], self.m[2]);
        let c = cross(n, mz);
        let (e, length) = (cross(a, mz), norm(mz));
        // Four parts of the thickness, each divided by the thickness; each has at most length one.
        let free = self.thickness_free && self.depth_slope[2] > F::ZERO;
        let (grad_thickness, inverse) =
            if free { (grad_thickness, F::ONE / self.depth_slope[2]) } else { (F::ZERO, F::ZERO) };
        let (along_p, along_c) = (dot(mz, p) * inverse, scale(c, b * inverse));
        let (along_e, rest) = (scale(e, inverse), b * b_u * length * inverse);
        let of_length = if length > F::ZERO { scale(mz, F::ONE / length) } else { mz };

        let mut grad_mz = add(scale(n, grad_u), scale(add(cross(p, n), scale(a, b_u)), grad_v));
        let through = add(add(scale(p, along_p), scale(cross(along_c, n), b)), cross(along_e, a));
        grad_mz = add(grad_mz, scale(add(through, scale(of_length, rest * b * b_u)), grad_thickness));
        let grad_n = add(scale(mz, grad_u), scale(cross(mz, p), grad_v));
        let grad_n = add(grad_n, scale(cross(mz, along_c), b * grad_thickness));
        let grad_p = add(scale(c, grad_v), scale(mz, along_p * grad_thickness));
        let grad_a = add(scale(mz, b_u * grad_v), scale(cross(mz, along_e), grad_thickness));
        let grad_b = grad_thickness * (dot(along_c, c) + rest * b_u * length);
        let grad_b_u = grad_v * dot(a, mz) + grad_thickness * rest * b * length;

        // p, a and b together have length one and the common denominator sigma_v.
        let radial = dot(grad_p, p) + dot(grad_a, a) + grad_b * b;
        let inverse_v = F::ONE / self.sigma_v;
        let grad_across = scale(sub(grad_p, scale(p, radial)), inverse_v);
        let grad_along = scale(sub(grad_a, scale(a, radial)), b);
        let grad_n = add(grad_n, cross(m1, grad_across));
        // n and bᵤ have the common denominator sigma_u.
        let radial = dot(grad_n, n) + grad_b_u * b_u + dot(grad_along, along);
        let inverse_u = F::ONE / self.sigma_u;
        let grad_m0 = scale(sub(grad_n, scale(n, radial)), inverse_u);
        let grad_m1 = add(cross(grad_across, n), scale(grad_along, inverse_u));
        [grad_m0, grad_m1, grad_mz]
    }
}

/// Returns the depth slopes and thicknesses and, with a lens, its columns: `[N, 3 (+ 6)]`.
pub(crate) fn depth_slope_cpu<F: Real>(inputs: Geometry<&[F]>, spec: &ProjectSpec) -> Vec<F> {
    let lens = ProjectCameraSimd::new(inputs.cam_from_world, spec);
    let columns = columns(&spec.intrinsics);
    let mut depth_slopes = vec![F::ZERO; inputs.opacities.len() * columns];
    depth_slopes.par_chunks_mut(columns).with_min_len(CHUNK).enumerate().for_each(|(i, row)| {
        if let Some(leaning) = DepthSlopeTermsCpu::new(&lens, &inputs, i) {
            if leaning.sound {
                row[..DEPTH_SLOPE].copy_from_slice(&leaning.depth_slope);
            }
            if let Some(frame) = leaning.frame() {
                row[DEPTH_SLOPE..].copy_from_slice(&frame);
            }
        }
    });
    depth_slopes
}

/// Gradients of one Gaussian.
struct DepthSlopeGaussianGrads<F> {
    mean: [F; 3],
    rotation: [F; 4],
    scale: [F; 3],
    /// The Gaussian's contribution to the gradient of the pose.
    pose: [F; 12],
}

fn backward_one<F: Real>(
    lens: &ProjectCameraSimd<F>,
    inputs: &Geometry<&[F]>,
    i: usize,
    row: &[F],
) -> Option<DepthSlopeGaussianGrads<F>> {
    if row.iter().all(|value| *value == F::ZERO) {
        return None;
    }
    let grad = [row[0], row[1], row[2]];
    let leaning = DepthSlopeTermsCpu::new(lens, inputs, i).filter(|leaning| leaning.sound)?;
    let three = |values: &[F]| [values[3 * i], values[3 * i + 1], values[3 * i + 2]];
    let (mean, scales) = (three(inputs.means), three(inputs.scales));
    let grad_m = leaning.factor_backward(grad);
    let by_row = |row: usize| hadamard(grad_m[row], leaning.j[row]);
    let grad_scale = add(add(by_row(0), by_row(1)), by_row(2));
    let grad_j = grad_m.map(|row| hadamard(row, scales));

    // The rows are differentiated as in `project`; the last one is divided by z.
    let inverse_z = F::ONE / leaning.mean_cam[2];
    let mut rows = [[F::ZERO; 3], [F::ZERO; 3], scale(grad_j[2], inverse_z)];
    let mut centre = [F::ZERO, F::ZERO, -dot(grad_j[2], leaning.j[2]) * inverse_z];
    if let Some(jacobian) = &leaning.bent {
        let mut grad_jacobian = [0, 1].map(|axis| matvec(&leaning.cam_from_gaussian, grad_j[axis]));
        for k in 0..3 {
            rows[k] = add(rows[k], add(scale(grad_j[0], jacobian[0][k]), scale(grad_j[1], jacobian[1][k])));
        }
        for (at, of_frame) in row[DEPTH_SLOPE + 2..].iter().enumerate() {
            grad_jacobian[at / 2][at % 2] += *of_frame * leaning.mean_cam[2];
            centre[2] += *of_frame * jacobian[at / 2][at % 2];
        }
        centre = add(centre, lens.lens_jacobian_backward(leaning.mean_cam, grad_jacobian));
    }
    for axis in (0..2).filter(|_| leaning.bent.is_none()) {
        rows[axis] = scale(grad_j[axis], lens.focal[axis] * inverse_z);
        rows[2] = sub(rows[2], scale(rows[axis], leaning.slope[axis]));
        centre[2] -= dot(grad_j[axis], leaning.j[axis]) * inverse_z;
        if leaning.slope_free[axis] {
            let grad_ratio = -dot(rows[axis], leaning.cam_from_gaussian[2]);
            centre[axis] = grad_ratio * inverse_z;
            centre[2] -= grad_ratio * leaning.ratio[axis] * inverse_z;
        }
    }
    let mut pose = [F::ZERO; 12];
    for (axis, pose) in pose.chunks_exact_mut(4).enumerate() {
        let row = add(matvec(&leaning.world_from_gaussian, rows[axis]), scale(mean, centre[axis]));
        pose[..3].copy_from_slice(&row);
        pose[3] = centre[axis];
    }
    let of_world = matmul(&transpose(&lens.rotation), &rows);
    Some(DepthSlopeGaussianGrads {
        mean: transposed_matvec(&lens.rotation, centre),
        rotation: quaternion_backward(leaning.quaternion, leaning.quaternion_length, &of_world),
        scale: grad_scale,
        pose,
    })
}

/// Returns the gradients of the inputs from `grad`, `[N, 3 (+ 6)]`. Opacities and projected centres have no gradient.
pub(crate) fn depth_slope_backward_cpu<F: Real>(
    inputs: Geometry<&[F]>,
    grad: &[F],
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Vec<F>> {
    let lens = ProjectCameraSimd::new(inputs.cam_from_world, spec);
    let mut grads = zero_grads(inputs.opacities.len(), needs);
    let found: Vec<Option<DepthSlopeGaussianGrads<F>>> = grad
        .par_chunks(columns(&spec.intrinsics))
        .with_min_len(CHUNK)
        .enumerate()
        .map(|(i, row)| backward_one(&lens, &inputs, i, row))
        .collect();
    fn put<F: Real>(to: &mut [F], i: usize, row: &[F]) {
        if !to.is_empty() {
            to[i * row.len()..(i + 1) * row.len()].copy_from_slice(row);
        }
    }
    let mut pose = [F::ZERO; 12];
    for (chunk, found) in found.chunks(CHUNK).enumerate() {
        let mut share = [F::ZERO; 12];
        for (i, found) in (chunk * CHUNK..).zip(found) {
            let Some(found) = found else { continue };
            put(&mut grads.means, i, &found.mean);
            put(&mut grads.rotations, i, &found.rotation);
            put(&mut grads.scales, i, &found.scale);
            share.iter_mut().zip(found.pose).for_each(|(sum, value)| *sum += value);
        }
        pose.iter_mut().zip(share).for_each(|(sum, value)| *sum += value);
    }
    if needs.cam_from_world {
        grads.cam_from_world = pose.to_vec();
    }
    grads
}

/// Returns the gradient of a quaternion of any length from the gradient of the matrix of its unit quaternion. The result is
/// clamped to the float's range where the length is too short.
fn quaternion_backward<F: Real>([w, x, y, z]: [F; 4], length: F, g: &Mat3<F>) -> [F; 4] {
    let two = F::of(2.0);
    let (ax, ay, az) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (sx, sy, sz) = (g[2][1] + g[1][2], g[0][2] + g[2][0], g[1][0] + g[0][1]);
    let grad_unit = [
        two * (x * ax + y * ay + z * az),
        two * (w * ax + y * sz + z * sy - two * x * (g[1][1] + g[2][2])),
        two * (w * ay + x * sz + z * sx - two * y * (g[0][0] + g[2][2])),
        two * (w * az + x * sy + y * sx - two * z * (g[0][0] + g[1][1])),
    ];
    let unit = [w, x, y, z];
    let radial = grad_unit.iter().zip(unit).map(|(g, q)| *g * q).sum::<F>();
    std::array::from_fn(|k| ((grad_unit[k] - unit[k] * radial) / length).within(-F::MAX, F::MAX))
}
