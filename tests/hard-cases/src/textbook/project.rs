//! Projection by the papers' formulas: a 3D covariance, its image under the Jacobian, a determinant and an inverse.

use splat_op::{CameraModel, Intrinsics, RenderOptions};

use super::linalg::{Mat3, Vec3, add, apply, dot, outer, plus, scale, times, transpose, zero};
use crate::number::Number;

/// Floor of the opacity compensation, as in gsplat.
const COMPENSATION_MIN: f64 = 0.005;

/// A pinhole camera with its pose and the limits of the Jacobian.
pub struct TextbookCamera<N> {
    pub rotation: Mat3<N>,
    pub translation: Vec3<N>,
    pub focal: [N; 2],
    pub principal: [N; 2],
    /// Slopes at which the Jacobian is clamped.
    low: [N; 2],
    high: [N; 2],
    near: N,
    blur: N,
    antialias: bool,
}

impl<N: Number> TextbookCamera<N> {
    /// # Panics
    /// If the camera is not a pinhole, the only model that the textbook implements.
    pub fn new(pose: &[f64], camera: &Intrinsics, options: &RenderOptions) -> Self {
        assert_eq!(camera.model, CameraModel::Pinhole, "the battery's cameras are pinholes");
        let row = |i: usize| [0, 1, 2].map(|j| N::of(pose[4 * i + j]));
        let focal = [N::of(camera.fx), N::of(camera.fy)];
        let principal = [N::of(camera.cx), N::of(camera.cy)];
        let size = [N::of(camera.width as f64), N::of(camera.height as f64)];
        let margin = |axis: usize| N::of(options.jacobian_margin) * size[axis] / (N::of(2.0) * focal[axis]);
        Self {
            rotation: [row(0), row(1), row(2)],
            translation: [3, 7, 11].map(|i| N::of(pose[i])),
            focal,
            principal,
            low: [0, 1].map(|i| -principal[i] / focal[i] - margin(i)),
            high: [0, 1].map(|i| (size[i] - principal[i]) / focal[i] + margin(i)),
            near: N::of(options.near),
            blur: N::of(options.blur),
            antialias: options.antialias,
        }
    }
}

/// One Gaussian's activated parameters.
#[derive(Clone, Copy, Debug)]
pub struct TextbookGaussian<N> {
    pub mean: Vec3<N>,
    /// Quaternion wxyz.
    pub quat: [N; 4],
    pub scale: Vec3<N>,
    pub opacity: N,
}

/// A Gaussian projected onto the picture, or its gradient.
#[derive(Clone, Copy, Debug)]
pub struct Conic<N> {
    pub mean_px: [N; 2],
    /// `a, b, c` of the inverse covariance `((a, b), (b, c))`.
    pub conic: [N; 3],
    pub depth: N,
    pub opacity: N,
}

/// Values of the forward pass that the backward pass needs.
pub struct TextbookProjection<N> {
    gaussian: TextbookGaussian<N>,
    quat_length: N,
    unit: [N; 4],
    rotation: Mat3<N>,
    mean_cam: Vec3<N>,
    slope: [N; 2],
    slope_free: [bool; 2],
    /// Covariances in the world frame and in the camera frame.
    covariance_world: Mat3<N>,
    covariance_cam: Mat3<N>,
    /// Two rows of the Jacobian and one row of zeros.
    jacobian: Mat3<N>,
    /// `a, b, c` without and with the blur, and both determinants.
    sharp: [N; 3],
    sharp_determinant: N,
    covariance: [N; 3],
    determinant: N,
    compensation: N,
    compensation_free: bool,
    pub conic: Conic<N>,
}

/// Gradients of one Gaussian, and its share of the pose's gradient.
pub struct Gradient<N> {
    pub mean: Vec3<N>,
    pub quat: [N; 4],
    pub scale: Vec3<N>,
    pub opacity: N,
    pub pose_rotation: Mat3<N>,
    pub pose_translation: Vec3<N>,
}

fn rotation_of<N: Number>([w, x, y, z]: [N; 4]) -> Mat3<N> {
    let (one, two) = (N::of(1.0), N::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// `a c − b²`.
fn determinant<N: Number>([a, b, c]: [N; 3]) -> N {
    a * c - b * b
}

/// Projects a Gaussian; `None` before the near plane and for a determinant that is not positive, as in most implementations.
pub fn project<N: Number>(gaussian: TextbookGaussian<N>, lens: &TextbookCamera<N>) -> Option<TextbookProjection<N>> {
    let zero_ = N::of(0.0);
    let mean_cam = add(apply(&lens.rotation, gaussian.mean), lens.translation);
    let [x, y, z] = mean_cam;
    if z <= lens.near {
        return None;
    }
    let q = gaussian.quat;
    let quat_length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    let unit = q.map(|c| c / quat_length);
    let rotation = rotation_of(unit);
    let axes = rotation.map(|row| [0, 1, 2].map(|k| row[k] * gaussian.scale[k]));
    let covariance_world = times(&axes, &transpose(&axes));
    let covariance_cam = times(&times(&lens.rotation, &covariance_world), &transpose(&lens.rotation));

    let ratio = [x / z, y / z];
    let slope = [0, 1].map(|i| {
        let raised = if ratio[i] < lens.low[i] { lens.low[i] } else { ratio[i] };
        if raised > lens.high[i] { lens.high[i] } else { raised }
    });
    let slope_free = [0, 1].map(|i| slope[i] == ratio[i]);
    let jacobian = [
        [lens.focal[0] / z, zero_, -(lens.focal[0] * slope[0]) / z],
        [zero_, lens.focal[1] / z, -(lens.focal[1] * slope[1]) / z],
        [zero_; 3],
    ];
    let image = times(&times(&jacobian, &covariance_cam), &transpose(&jacobian));
    let sharp = [image[0][0], image[0][1], image[1][1]];
    let covariance = [sharp[0] + lens.blur, sharp[1], sharp[2] + lens.blur];
    let (sharp_determinant, determinant) = (determinant(sharp), determinant(covariance));
    if determinant <= zero_ {
        return None;
    }
    let inverse = N::of(1.0) / determinant;
    let conic = [covariance[2] * inverse, -(covariance[1] * inverse), covariance[0] * inverse];
    let (mut compensation, mut compensation_free) = (N::of(1.0), false);
    if lens.antialias {
        let share = sharp_determinant / determinant;
        compensation = if share > zero_ { share.sqrt() } else { zero_ };
        compensation_free = compensation > N::of(COMPENSATION_MIN);
        if !compensation_free {
            compensation = N::of(COMPENSATION_MIN);
        }
    }
    let conic = Conic {
        mean_px: [0, 1].map(|i| lens.focal[i] * ratio[i] + lens.principal[i]),
        conic,
        depth: z,
        opacity: gaussian.opacity * compensation,
    };
    Some(TextbookProjection {
        gaussian,
        quat_length,
        unit,
        rotation,
        mean_cam,
        slope,
        slope_free,
        covariance_world,
        covariance_cam,
        jacobian,
        sharp,
        sharp_determinant,
        covariance,
        determinant,
        compensation,
        compensation_free,
        conic,
    })
}

impl<N: Number> TextbookProjection<N> {
    /// Ratio of the larger to the smaller eigenvalue of the 2D covariance.
    pub fn condition(&self) -> f64 {
        let [a, _, c] = self.covariance;
        let half = (a + c) / N::of(2.0);
        let squared = half * half - self.determinant;
        let larger = half + if squared > N::of(0.0) { squared.sqrt() } else { N::of(0.0) };
        (larger * larger / self.determinant).f64()
    }

    /// Gradient of the covariance `a, b, c` without blur, from the conic's gradient: `−K G K`, and through the compensation.
    fn covariance_backward(&self, grad: &Conic<N>) -> [N; 3] {
        let [a, b, c] = self.conic.conic;
        // `b` is two entries of the matrix, and each gets half of the gradient.
        let half = N::of(0.5);
        let [ga, gb, gc] = [grad.conic[0], half * grad.conic[1], grad.conic[2]];
        // Rows of G K.
        let (g00, g01) = (ga * a + gb * b, ga * b + gb * c);
        let (g10, g11) = (gb * a + gc * b, gb * b + gc * c);
        let mut out = [-(a * g00 + b * g10), -(N::of(2.0) * (a * g01 + b * g11)), -(b * g01 + c * g11)];
        if self.compensation_free {
            // compensation² = det sharp / det
            let grad_share = grad.opacity * self.gaussian.opacity * half / self.compensation;
            let per_sharp = grad_share / self.determinant;
            let per_blurred = grad_share * self.sharp_determinant / (self.determinant * self.determinant);
            let two = N::of(2.0);
            out[0] = out[0] + per_sharp * self.sharp[2] - per_blurred * self.covariance[2];
            out[1] = out[1] - two * (per_sharp * self.sharp[1] - per_blurred * self.covariance[1]);
            out[2] = out[2] + per_sharp * self.sharp[0] - per_blurred * self.covariance[0];
        }
        out
    }

    pub fn backward(&self, lens: &TextbookCamera<N>, grad: &Conic<N>) -> Gradient<N> {
        let (nought, half, two) = (N::of(0.0), N::of(0.5), N::of(2.0));
        let [ga, gb, gc] = self.covariance_backward(grad);
        let mut grad_image = zero();
        grad_image[0] = [ga, half * gb, nought];
        grad_image[1] = [half * gb, gc, nought];
        // image = J C Jᵀ with symmetric C
        let grad_cam = times(&times(&transpose(&self.jacobian), &grad_image), &self.jacobian);
        let grad_jacobian = times(&times(&grad_image, &self.jacobian), &self.covariance_cam).map(|row| scale(row, two));

        let [x, y, z] = self.mean_cam;
        let mut grad_mean = [nought, nought, grad.depth];
        for (axis, across) in [(0, x), (1, y)] {
            let (focal, slope) = (lens.focal[axis], self.slope[axis]);
            grad_mean[axis] = grad_mean[axis] + grad.mean_px[axis] * focal / z;
            grad_mean[2] = grad_mean[2] - grad.mean_px[axis] * focal * across / (z * z);
            // ∂(focal / z), and of −focal slope / z
            let (scaled, slanted) = (grad_jacobian[axis][axis], grad_jacobian[axis][2]);
            grad_mean[2] = grad_mean[2] - scaled * focal / (z * z) + slanted * focal * slope / (z * z);
            if self.slope_free[axis] {
                let grad_slope = -(slanted * focal / z);
                grad_mean[axis] = grad_mean[axis] + grad_slope / z;
                grad_mean[2] = grad_mean[2] - grad_slope * across / (z * z);
            }
        }

        let w = &lens.rotation;
        let grad_world = times(&times(&transpose(w), &grad_cam), w);
        // C = W S Wᵀ with symmetric S
        let of_covariance = times(&times(&grad_cam, w), &self.covariance_world).map(|row| scale(row, two));
        let pose_rotation = plus(&of_covariance, &outer(grad_mean, self.gaussian.mean));

        // S = A Aᵀ, A = R diag(s)
        let s = self.gaussian.scale;
        let axes = self.rotation.map(|row| [0, 1, 2].map(|k| row[k] * s[k]));
        let grad_axes = times(&grad_world, &axes).map(|row| scale(row, two));
        let columns = |m: &Mat3<N>| transpose(m);
        let (grad_columns, rotation_columns) = (columns(&grad_axes), columns(&self.rotation));
        let grad_rotation = grad_axes.map(|row| [0, 1, 2].map(|k| row[k] * s[k]));
        Gradient {
            mean: apply(&transpose(w), grad_mean),
            quat: self.quat_backward(&grad_rotation),
            scale: [0, 1, 2].map(|k| dot(grad_columns[k], rotation_columns[k])),
            opacity: grad.opacity * self.compensation,
            pose_rotation,
            pose_translation: grad_mean,
        }
    }

    /// Gradient of the quaternion, through the rotation matrix and then through `q / |q|`.
    fn quat_backward(&self, g: &Mat3<N>) -> [N; 4] {
        let [w, x, y, z] = self.unit;
        let two = N::of(2.0);
        let grad_unit = [
            two * (x * (g[2][1] - g[1][2]) + y * (g[0][2] - g[2][0]) + z * (g[1][0] - g[0][1])),
            two * (y * (g[0][1] + g[1][0]) + z * (g[0][2] + g[2][0]) + w * (g[2][1] - g[1][2])
                - two * x * (g[1][1] + g[2][2])),
            two * (x * (g[0][1] + g[1][0]) + z * (g[1][2] + g[2][1]) + w * (g[0][2] - g[2][0])
                - two * y * (g[0][0] + g[2][2])),
            two * (x * (g[0][2] + g[2][0]) + y * (g[1][2] + g[2][1]) + w * (g[1][0] - g[0][1])
                - two * z * (g[0][0] + g[1][1])),
        ];
        let along = grad_unit[0] * w + grad_unit[1] * x + grad_unit[2] * y + grad_unit[3] * z;
        [0, 1, 2, 3].map(|i| (grad_unit[i] - self.unit[i] * along) / self.quat_length)
    }
}
