//! The CPU twin of `evaluate_sh`: both passes, generic over the float, parallel over chunks of Gaussians.

use super::basis::{basis, basis_backward};
use super::{SH_COEFFICIENTS_MAX, Shading, degree_of, extent_sigmas};
use crate::linalg::{Matrix3, add, cross, dot, matvec, norm, scale, sub, transpose, transposed_matvec};
use crate::project::{COLUMNS, Ellipse, ProjectSpec};
use crate::simd::Real;
use crate::tasks;

/// Number of Gaussians per task, and per partial sum of the pose's gradient, whose sum is ordered.
const CHUNK: usize = 1024;

/// Borrowed inputs, row-major.
#[derive(Clone, Copy)]
pub(crate) struct ShCpuInputs<'a, F> {
    pub sh: &'a [F],
    pub means: &'a [F],
    pub cam_from_world: &'a [F],
    /// Number of coefficients per channel.
    pub coefficients: usize,
}

/// Position of the camera in the world frame: the point that the pose maps to zero, `−A⁻¹ t`. It uses the general inverse, so that
/// it holds for any invertible `A` and every entry of the pose is a free variable.
struct CameraPositionCpu<F> {
    /// `A⁻¹`.
    world_from_cam: Matrix3<F>,
    position: [F; 3],
}

impl<F: Real> CameraPositionCpu<F> {
    fn new(p: &[F]) -> Self {
        let rows = [[p[0], p[1], p[2]], [p[4], p[5], p[6]], [p[8], p[9], p[10]]];
        let cofactors = [cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])];
        let determinant = dot(rows[0], cofactors[0]);
        let world_from_cam = transpose(&cofactors.map(|row| scale(row, F::ONE / determinant)));
        let position = scale(matvec(&world_from_cam, [p[3], p[7], p[11]]), -F::ONE);
        Self { world_from_cam, position }
    }

    /// Gradient of the pose from the gradient `g` of the position: `∂t = −A⁻ᵀ g`, `∂A = ∂t positionᵀ`.
    fn backward(&self, grad_position: [F; 3]) -> Vec<F> {
        let grad_t = scale(transposed_matvec(&self.world_from_cam, grad_position), -F::ONE);
        let mut pose = Vec::with_capacity(12);
        for g in grad_t {
            pose.extend(scale(self.position, g));
            pose.push(g);
        }
        pose
    }

    /// Unit direction from the camera to a centre, and the distance, scene units; +z for a centre at the camera's position.
    #[inline(always)]
    fn direction(&self, mean: &[F]) -> ([F; 3], F) {
        let to_mean = sub([mean[0], mean[1], mean[2]], self.position);
        let distance = norm(to_mean);
        if distance > F::ZERO {
            (scale(to_mean, F::ONE / distance), distance)
        } else {
            ([F::ZERO, F::ZERO, F::ONE], distance)
        }
    }
}

/// Colour before the clamp.
#[inline(always)]
fn linear_colour<F: Real>(y: &[F; SH_COEFFICIENTS_MAX], sh: &[F]) -> [F; 3] {
    let mut colour = [F::of(0.5); 3];
    for (weight, c) in y.iter().zip(sh.as_chunks().0) {
        colour = add(colour, scale(*c, *weight));
    }
    colour
}

/// Visibility of Gaussians in a picture; see [`super`].
pub(crate) struct Visible<'a, F> {
    /// `[N, 7]` packed ellipses.
    ellipses: &'a [F],
    sigmas: F,
    /// Width and height of the picture, px.
    size: [F; 2],
}

impl<'a, F: Real> Visible<'a, F> {
    pub fn new(ellipses: &'a [F], spec: &ProjectSpec) -> Self {
        let size = [spec.intrinsics.width, spec.intrinsics.height].map(|px| F::of(px as f64));
        Self { ellipses, sigmas: F::of(extent_sigmas(spec.options.alpha_min)), size }
    }

    #[inline(always)]
    fn has(&self, i: usize) -> bool {
        let ellipse = Ellipse::from_row(&self.ellipses[COLUMNS * i..COLUMNS * (i + 1)]);
        let half = [ellipse.sigma_u, ellipse.sigma_v + ellipse.shear.abs() * ellipse.sigma_u];
        let meets = |axis: usize| {
            let (centre, half) = (ellipse.mean_px[axis], self.sigmas * half[axis] + F::ONE);
            centre + half >= F::ZERO && centre - half <= self.size[axis]
        };
        ellipse.opacity > F::ONE || (ellipse.opacity > F::ZERO && meets(0) && meets(1))
    }
}

/// `[N, 3]` colours of the visible Gaussians, zero for the others. Without a visibility all Gaussians are visible.
pub(crate) fn sh_cpu<F: Real>(inputs: ShCpuInputs<F>, visible: Option<&Visible<F>>) -> Vec<F> {
    let eye = CameraPositionCpu::new(inputs.cam_from_world);
    let row = 3 * inputs.coefficients;
    let degree = degree_of(inputs.coefficients);
    let mut colours = vec![F::ZERO; inputs.means.len()];
    tasks::for_each(colours.chunks_mut(3 * CHUNK), |chunk, out| {
        for (i, out) in out.chunks_exact_mut(3).enumerate() {
            let i = chunk * CHUNK + i;
            if visible.is_some_and(|visible| !visible.has(i)) {
                continue;
            }
            let (direction, _) = eye.direction(&inputs.means[3 * i..3 * i + 3]);
            let colour = linear_colour(&basis(direction, degree), &inputs.sh[row * i..row * (i + 1)]);
            out.copy_from_slice(&colour.map(|c| c.max_of(F::ZERO)));
        }
    });
    colours
}

/// Gradients of the inputs from `grad`, the `[N, 3]` gradient of the colours.
pub(crate) fn sh_backward_cpu<F: Real>(
    inputs: ShCpuInputs<F>,
    visible: Option<&Visible<F>>,
    grad: &[F],
    needs: Shading<bool>,
) -> Shading<Vec<F>> {
    let eye = CameraPositionCpu::new(inputs.cam_from_world);
    let row = 3 * inputs.coefficients;
    let degree = degree_of(inputs.coefficients);
    let count = inputs.means.len() / 3;
    let chunks = count.div_ceil(CHUNK);
    let through_direction = needs.means || needs.cam_from_world;
    let zeros = |needed: bool, len: usize| vec![F::ZERO; if needed { len } else { 0 }];
    let mut grads = Shading {
        sh: zeros(needs.sh, inputs.sh.len()),
        means: zeros(needs.means, inputs.means.len()),
        cam_from_world: Vec::new(),
    };
    let mut sh_chunks: Vec<&mut [F]> = grads.sh.chunks_mut(row * CHUNK).collect();
    let mut mean_chunks: Vec<&mut [F]> = grads.means.chunks_mut(3 * CHUNK).collect();
    sh_chunks.resize_with(chunks, Default::default);
    mean_chunks.resize_with(chunks, Default::default);
    let parts = sh_chunks.into_iter().zip(mean_chunks);
    let positions = tasks::map(parts, |chunk, (grad_sh, grad_means)| {
        let mut grad_position = [F::ZERO; 3];
        for local in 0..CHUNK.min(count - chunk * CHUNK) {
            let i = chunk * CHUNK + local;
            let g = [grad[3 * i], grad[3 * i + 1], grad[3 * i + 2]];
            // Also keeps the values of a Gaussian that is not visible, NaN included, out of every sum.
            if g == [F::ZERO; 3] || visible.is_some_and(|visible| !visible.has(i)) {
                continue;
            }
            let sh = &inputs.sh[row * i..row * (i + 1)];
            let (direction, distance) = eye.direction(&inputs.means[3 * i..3 * i + 3]);
            let y = basis(direction, degree);
            let colour = linear_colour(&y, sh);
            let g = [0, 1, 2].map(|c| if colour[c] > F::ZERO { g[c] } else { F::ZERO });
            if needs.sh {
                for (out, weight) in grad_sh[row * local..row * (local + 1)].as_chunks_mut().0.iter_mut().zip(&y) {
                    *out = scale(g, *weight);
                }
            }
            if through_direction && degree > 0 && distance > F::ZERO {
                let to_mean = direction_backward(direction, distance, degree, sh, g);
                if needs.means {
                    grad_means[3 * local..3 * local + 3].copy_from_slice(&to_mean);
                }
                grad_position = sub(grad_position, to_mean);
            }
        }
        grad_position
    });
    if needs.cam_from_world {
        grads.cam_from_world = eye.backward(positions.into_iter().fold([F::ZERO; 3], add));
    }
    grads
}

/// Gradient of the vector from the camera to a centre: through the basis, then through the normalisation.
#[inline(always)]
fn direction_backward<F: Real>(direction: [F; 3], distance: F, degree: usize, sh: &[F], g: [F; 3]) -> [F; 3] {
    let mut grad_basis = [F::ZERO; SH_COEFFICIENTS_MAX];
    for (out, c) in grad_basis.iter_mut().zip(sh.as_chunks().0) {
        *out = dot(g, *c);
    }
    let grad = basis_backward(direction, degree, &grad_basis);
    scale(sub(grad, scale(direction, dot(direction, grad))), F::ONE / distance)
}
