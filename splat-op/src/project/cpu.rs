//! The CPU twin of `project`: both passes, generic over the float, parallel over chunks of Gaussians.

use rayon::prelude::*;

use super::{COLUMNS, COMPENSATION_MIN, Ellipse, ProjectNeeds, ProjectSpec};
use crate::linalg::{
    Mat3, add, cross, dot, hadamard, matmul, matvec, norm, quaternion_backward, rotation_of, scale, sub,
    transposed_matvec, unit_quaternion,
};
use crate::real::Real;

/// Gaussians per task. Sums over all Gaussians add one partial sum per chunk in order, so the number of threads never
/// changes a result.
const CHUNK: usize = 1024;

/// Borrowed inputs, row-major.
#[derive(Clone, Copy)]
pub(crate) struct Inputs<'a, F> {
    pub means: &'a [F],
    pub rotations: &'a [F],
    pub scales: &'a [F],
    pub opacities: &'a [F],
    pub cam_from_world: &'a [F],
}

/// Gradients; an empty vector where none was asked for.
pub(crate) struct Grads<F> {
    pub means: Vec<F>,
    pub rotations: Vec<F>,
    pub scales: Vec<F>,
    pub opacities: Vec<F>,
    pub cam_from_world: Vec<F>,
    pub mean2d: Vec<F>,
}

/// The camera in the working float type.
struct Lens<F> {
    rotation: Mat3<F>,
    translation: [F; 3],
    focal: [F; 2],
    principal: [F; 2],
    /// `x/z` and `y/z` at which the Jacobian is held.
    low: [F; 2],
    high: [F; 2],
    near: F,
    blur: F,
    antialias: bool,
}

impl<F: Real> Lens<F> {
    fn new(cam_from_world: &[F], spec: &ProjectSpec) -> Self {
        let (camera, options) = (&spec.intrinsics, &spec.options);
        let limits = |size: usize, focal: f64, principal: f64| {
            let margin = options.jacobian_margin * size as f64 / (2.0 * focal);
            (F::of(-principal / focal - margin), F::of((size as f64 - principal) / focal + margin))
        };
        let (low_x, high_x) = limits(camera.width, camera.fx, camera.cx);
        let (low_y, high_y) = limits(camera.height, camera.fy, camera.cy);
        let p = cam_from_world;
        Self {
            rotation: [[p[0], p[1], p[2]], [p[4], p[5], p[6]], [p[8], p[9], p[10]]],
            translation: [p[3], p[7], p[11]],
            focal: [F::of(camera.fx), F::of(camera.fy)],
            principal: [F::of(camera.cx), F::of(camera.cy)],
            low: [low_x, low_y],
            high: [high_x, high_y],
            near: F::of(options.near),
            blur: F::of(options.blur),
            antialias: options.antialias,
        }
    }
}

/// One Gaussian's parameters.
#[derive(Clone, Copy)]
struct Gaussian<F> {
    mean: [F; 3],
    rotation: [F; 4],
    scale: [F; 3],
    opacity: F,
}

impl<F: Real> Gaussian<F> {
    #[inline(always)]
    fn read(inputs: &Inputs<F>, i: usize) -> Self {
        let (m, q, s) = (&inputs.means[3 * i..], &inputs.rotations[4 * i..], &inputs.scales[3 * i..]);
        Self {
            mean: [m[0], m[1], m[2]],
            rotation: [q[0], q[1], q[2], q[3]],
            scale: [s[0], s[1], s[2]],
            opacity: inputs.opacities[i],
        }
    }

    fn finite(&self) -> bool {
        let all = |values: &[F]| values.iter().all(|v| v.finite());
        all(&self.mean) && all(&self.rotation) && all(&self.scale) && self.opacity.finite()
    }
}

/// What the forward pass computes on its way and the backward pass needs again.
struct Projection<F> {
    mean_cam: [F; 3],
    /// `x/z, y/z`; the slopes at which the Jacobian is taken; whether each is free (not held at a limit).
    ratio: [F; 2],
    slope: [F; 2],
    slope_free: [bool; 2],
    quaternion: [F; 4],
    quaternion_length: F,
    world_from_gaussian: Mat3<F>,
    cam_from_gaussian: Mat3<F>,
    /// `j0, j1`: rows of `J W R`; `m0, m1`: the same times the scales.
    j: [[F; 3]; 2],
    m: [[F; 3]; 2],
    /// `n = m0 / sigma_u`, `along = m1 / sigma_u`, `p = n × m1`.
    n: [F; 3],
    along: [F; 3],
    p: [F; 3],
    sigma_u: F,
    shear: F,
    sigma_v: F,
    /// What the opacity is multiplied by, and whether it is free (not held at its floor, not one throughout).
    compensation: F,
    compensation_free: bool,
}

/// `None` for a Gaussian that is culled: not finite, without a rotation, or not in front of the near plane.
#[inline(always)]
fn project_one<F: Real>(g: &Gaussian<F>, lens: &Lens<F>) -> Option<Projection<F>> {
    if !g.finite() {
        return None;
    }
    let mean_cam = add(matvec(&lens.rotation, g.mean), lens.translation);
    let [x, y, z] = mean_cam;
    let ratio = [x / z, y / z];
    if !(z > lens.near && z > F::ZERO && z.finite() && ratio[0].finite() && ratio[1].finite()) {
        return None;
    }
    let (quaternion, quaternion_length) = unit_quaternion(g.rotation)?;
    let world_from_gaussian = rotation_of(quaternion);
    let cam_from_gaussian = matmul(&lens.rotation, &world_from_gaussian);

    let slope = [ratio[0].within(lens.low[0], lens.high[0]), ratio[1].within(lens.low[1], lens.high[1])];
    let slope_free = [slope[0] == ratio[0], slope[1] == ratio[1]];
    let row = |axis: usize| {
        let leaning = sub(cam_from_gaussian[axis], scale(cam_from_gaussian[2], slope[axis]));
        scale(leaning, lens.focal[axis] / z)
    };
    let j = [row(0), row(1)];
    let m = [hadamard(j[0], g.scale), hadamard(j[1], g.scale)];

    let blur_sigma = lens.blur.sqrt();
    let sigma_u = norm([norm(m[0]), blur_sigma, F::ZERO]);
    if !(sigma_u > F::ZERO && sigma_u.finite()) {
        return None;
    }
    let n = scale(m[0], F::ONE / sigma_u);
    let along = scale(m[1], F::ONE / sigma_u);
    let p = cross(n, m[1]);
    let p_norm = norm(p);
    let sigma_v = norm([blur_sigma, p_norm, blur_sigma * norm(along)]);
    let shear = dot(n, along);
    if !(sigma_v > F::ZERO && sigma_v.finite() && shear.finite()) {
        return None;
    }
    let (compensation, compensation_free) = if lens.antialias {
        let areas = p_norm / sigma_v;
        let floor = F::of(COMPENSATION_MIN);
        if areas > floor { (areas, true) } else { (floor, false) }
    } else {
        (F::ONE, false)
    };
    Some(Projection {
        mean_cam,
        ratio,
        slope,
        slope_free,
        quaternion,
        quaternion_length,
        world_from_gaussian,
        cam_from_gaussian,
        j,
        m,
        n,
        along,
        p,
        sigma_u,
        shear,
        sigma_v,
        compensation,
        compensation_free,
    })
}

impl<F: Real> Projection<F> {
    #[inline(always)]
    fn ellipse(&self, lens: &Lens<F>, opacity: F) -> Ellipse<F> {
        Ellipse {
            mean_px: [
                lens.focal[0] * self.ratio[0] + lens.principal[0],
                lens.focal[1] * self.ratio[1] + lens.principal[1],
            ],
            sigma_u: self.sigma_u,
            shear: self.shear,
            sigma_v: self.sigma_v,
            depth: self.mean_cam[2],
            opacity: opacity * self.compensation,
        }
    }

    /// Gradients of `m0, m1` and of the opacity from those of the ellipse.
    #[inline(always)]
    fn factor_backward(&self, lens: &Lens<F>, opacity: F, grad: &Ellipse<F>) -> ([[F; 3]; 2], F) {
        let blur = lens.blur;
        let mut grad_p = [F::ZERO; 3];
        let mut grad_along = scale(self.n, grad.shear);
        if self.compensation_free {
            // With P = |p| and S = sigma_v, whose square is ε + P² + ε |along|²:
            // d(P/S) = (ε + ε |along|²)/S² dP/S − P/S ε along·d along / S². Without blur nothing is left, and it is exactly
            // zero: no difference of almost equal numbers.
            let grad_compensation = grad.opacity * opacity;
            let blurred = blur.sqrt() / self.sigma_v;
            let lost = blurred * norm([F::ONE, norm(self.along), F::ZERO]);
            let unit = scale(self.p, F::ONE / norm(self.p));
            grad_p = scale(unit, grad_compensation * lost * lost / self.sigma_v);
            let along = grad_compensation * self.compensation * blurred * blurred;
            grad_along = sub(grad_along, scale(self.along, along));
        }
        let relative = grad.sigma_v / self.sigma_v;
        grad_p = add(grad_p, scale(self.p, relative));
        grad_along = add(grad_along, scale(self.along, blur * relative));
        let grad_n = add(scale(self.along, grad.shear), cross(self.m[1], grad_p));
        let inverse = F::ONE / self.sigma_u;
        let grad_sigma_u = grad.sigma_u - (dot(grad_along, self.along) + dot(grad_n, self.n)) * inverse;
        let grad_m0 = add(scale(grad_n, inverse), scale(self.n, grad_sigma_u));
        let grad_m1 = add(cross(grad_p, self.n), scale(grad_along, inverse));
        ([grad_m0, grad_m1], grad.opacity * self.compensation)
    }
}

/// Gradients of one Gaussian and its share of the pose's.
struct GradOne<F> {
    mean: [F; 3],
    rotation: [F; 4],
    scale: [F; 3],
    opacity: F,
    pose_rotation: Mat3<F>,
    pose_translation: [F; 3],
}

#[inline(always)]
fn backward_one<F: Real>(g: &Gaussian<F>, lens: &Lens<F>, grad: &Ellipse<F>) -> Option<GradOne<F>> {
    let f = project_one(g, lens)?;
    let (grad_m, opacity) = f.factor_backward(lens, g.opacity, grad);
    let inverse_z = F::ONE / f.mean_cam[2];

    let mut grad_cam = [F::ZERO, F::ZERO, grad.depth];
    let mut grad_cam_from_gaussian = [[F::ZERO; 3]; 3];
    let mut grad_scale = [F::ZERO; 3];
    for axis in 0..2 {
        let per_z = lens.focal[axis] * inverse_z;
        grad_scale = add(grad_scale, hadamard(grad_m[axis], f.j[axis]));
        // j = (focal / z) (row - slope · last row)
        let grad_j = hadamard(grad_m[axis], g.scale);
        let grad_leaning = scale(grad_j, per_z);
        grad_cam_from_gaussian[axis] = grad_leaning;
        grad_cam_from_gaussian[2] = sub(grad_cam_from_gaussian[2], scale(grad_leaning, f.slope[axis]));
        grad_cam[2] -= dot(grad_j, f.j[axis]) * inverse_z;
        let mut grad_ratio = grad.mean_px[axis] * lens.focal[axis];
        if f.slope_free[axis] {
            grad_ratio -= dot(grad_leaning, f.cam_from_gaussian[2]);
        }
        grad_cam[axis] = grad_ratio * inverse_z;
        grad_cam[2] -= grad_ratio * f.ratio[axis] * inverse_z;
    }

    // cam_from_gaussian = pose rotation · world_from_gaussian
    let mut pose_rotation = [[F::ZERO; 3]; 3];
    for (row, grad_row) in pose_rotation.iter_mut().zip(grad_cam_from_gaussian) {
        *row = matvec(&f.world_from_gaussian, grad_row);
    }
    let columns = [0, 1, 2].map(|column| grad_cam_from_gaussian.map(|row| row[column]));
    let by_column = columns.map(|column| transposed_matvec(&lens.rotation, column));
    let grad_world_from_gaussian = [0, 1, 2].map(|row| by_column.map(|column| column[row]));
    for (row, grad_axis) in pose_rotation.iter_mut().zip(grad_cam) {
        *row = add(*row, scale(g.mean, grad_axis));
    }
    Some(GradOne {
        mean: transposed_matvec(&lens.rotation, grad_cam),
        rotation: quaternion_backward(f.quaternion, f.quaternion_length, &grad_world_from_gaussian),
        scale: grad_scale,
        opacity,
        pose_rotation,
        pose_translation: grad_cam,
    })
}

/// `[N, 7]` packed ellipses.
pub(crate) fn project_cpu<F: Real>(inputs: Inputs<F>, spec: &ProjectSpec) -> Vec<F> {
    let lens = Lens::new(inputs.cam_from_world, spec);
    let count = inputs.opacities.len();
    let mut packed = vec![F::ZERO; count * COLUMNS];
    packed.par_chunks_mut(CHUNK * COLUMNS).enumerate().for_each(|(chunk, rows)| {
        for (i, row) in rows.chunks_exact_mut(COLUMNS).enumerate() {
            let g = Gaussian::read(&inputs, chunk * CHUNK + i);
            let ellipse = match project_one(&g, &lens) {
                Some(projection) => projection.ellipse(&lens, g.opacity),
                None => Ellipse { sigma_u: F::ONE, sigma_v: F::ONE, ..Ellipse::default() },
            };
            row.copy_from_slice(&ellipse.to_row());
        }
    });
    packed
}

/// Gradients of the inputs from `grad`, the `[N, 7]` gradient of the packed ellipses.
pub(crate) fn project_backward_cpu<F: Real>(
    inputs: Inputs<F>,
    grad: &[F],
    spec: &ProjectSpec,
    needs: ProjectNeeds,
) -> Grads<F> {
    let lens = Lens::new(inputs.cam_from_world, spec);
    let count = inputs.opacities.len();
    let rows = |needed: bool, columns: usize| vec![F::ZERO; if needed { count * columns } else { 0 }];
    let mut grads = Grads {
        means: rows(needs.means, 3),
        rotations: rows(needs.rotations, 4),
        scales: rows(needs.scales, 3),
        opacities: rows(needs.opacities, 1),
        cam_from_world: Vec::new(),
        mean2d: rows(needs.mean2d, 2),
    };
    let chunks = count.div_ceil(CHUNK);
    let pose: Vec<[F; 12]> = {
        let mut means = split(&mut grads.means, 3, chunks);
        let mut rotations = split(&mut grads.rotations, 4, chunks);
        let mut scales = split(&mut grads.scales, 3, chunks);
        let mut opacities = split(&mut grads.opacities, 1, chunks);
        let mut mean2d = split(&mut grads.mean2d, 2, chunks);
        let tasks = (
            means.par_iter_mut(),
            rotations.par_iter_mut(),
            scales.par_iter_mut(),
            opacities.par_iter_mut(),
            mean2d.par_iter_mut(),
        );
        tasks
            .into_par_iter()
            .enumerate()
            .map(|(chunk, (means, rotations, scales, opacities, mean2d))| {
                let mut pose = [F::ZERO; 12];
                for i in 0..CHUNK.min(count - chunk * CHUNK) {
                    let row = chunk * CHUNK + i;
                    let grad = Ellipse::from_row(&grad[row * COLUMNS..]);
                    // Most Gaussians of a large scene are out of view, and their gradient is exactly zero.
                    if grad == Ellipse::default() {
                        continue;
                    }
                    let Some(one) = backward_one(&Gaussian::read(&inputs, row), &lens, &grad) else { continue };
                    store(means, i, &one.mean);
                    store(rotations, i, &one.rotation);
                    store(scales, i, &one.scale);
                    store(opacities, i, &[one.opacity]);
                    store(mean2d, i, &grad.mean_px);
                    for axis in 0..3 {
                        for column in 0..3 {
                            pose[4 * axis + column] += one.pose_rotation[axis][column];
                        }
                        pose[4 * axis + 3] += one.pose_translation[axis];
                    }
                }
                pose
            })
            .collect()
    };
    if needs.cam_from_world {
        let mut total = [F::ZERO; 12];
        for part in pose {
            total.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
        }
        grads.cam_from_world = total.to_vec();
    }
    grads
}

/// One slice per chunk; empty slices where the gradient is not needed.
fn split<F>(rows: &mut [F], columns: usize, chunks: usize) -> Vec<&mut [F]> {
    let mut parts: Vec<&mut [F]> = rows.chunks_mut(CHUNK * columns).collect();
    parts.resize_with(chunks, Default::default);
    parts
}

#[inline(always)]
fn store<F: Copy>(rows: &mut [F], i: usize, values: &[F]) {
    if !rows.is_empty() {
        rows[i * values.len()..(i + 1) * values.len()].copy_from_slice(values);
    }
}
