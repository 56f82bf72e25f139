//! The render of `splat_op` as ordinary Burn tensor code over all pairs of Gaussians and pixels, without
//! tiles or thresholds. Burn's autodiff computes its gradients. It shares no code with the operation: covariances are
//! formed and inverted by the papers' formulas.

use burn::tensor::{Int, Tensor, TensorData};
use splat_op::{CameraModel, Intrinsics, RenderOptions};

use crate::scene::host;

/// Floor of the opacity compensation in gsplat, repeated here so that the operation's constant is checked.
const COMPENSATION_MIN: f64 = 0.005;

/// Projected Gaussians, as columns `[N]`.
#[derive(Clone)]
pub struct DenseEllipses {
    pub mean2d: [Tensor<1>; 2],
    pub sigma_u: Tensor<1>,
    pub shear: Tensor<1>,
    pub sigma_v: Tensor<1>,
    pub depth: Tensor<1>,
    pub opacity: Tensor<1>,
}

/// A render: colour `[P, C]`, alpha `[P]`, depth `[P]`, pixels row by row.
pub struct DensePicture {
    pub colour: Tensor<2>,
    pub alpha: Tensor<1>,
    pub depth: Tensor<1>,
}

type Vec3 = [Tensor<1>; 3];

fn column(t: &Tensor<2>, i: usize) -> Tensor<1> {
    let rows = t.dims()[0];
    t.clone().slice([0..rows, i..i + 1]).squeeze_dim(1)
}

/// Returns an element of a `[3, 4]` pose as `[1]`, which broadcasts over Gaussians.
fn entry(pose: &Tensor<2>, row: usize, col: usize) -> Tensor<1> {
    pose.clone().slice([row..row + 1, col..col + 1]).reshape([1])
}

fn dot(a: &Vec3, b: &Vec3) -> Tensor<1> {
    a[0].clone() * b[0].clone() + a[1].clone() * b[1].clone() + a[2].clone() * b[2].clone()
}

fn cross(a: &Vec3, b: &Vec3) -> Vec3 {
    let minor = |i: usize, j: usize| a[i].clone() * b[j].clone() - a[j].clone() * b[i].clone();
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

/// Returns the rows of the rotation matrices of quaternions wxyz of any length.
fn rotations(quats: &Tensor<2>) -> [Vec3; 3] {
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| column(quats, i));
    let squared = w.clone().square() + x.clone().square() + y.clone().square() + z.clone().square();
    let two = |a: &Tensor<1>, b: &Tensor<1>| a.clone() * b.clone() * 2.0 / squared.clone();
    let one = |a: Tensor<1>| a.neg() + 1.0;
    [
        [one(two(&y, &y) + two(&z, &z)), two(&x, &y) - two(&w, &z), two(&x, &z) + two(&w, &y)],
        [two(&x, &y) + two(&w, &z), one(two(&x, &x) + two(&z, &z)), two(&y, &z) - two(&w, &x)],
        [two(&x, &z) - two(&w, &y), two(&y, &z) + two(&w, &x), one(two(&x, &x) + two(&y, &y))],
    ]
}

/// The rows of `J W R diag(s)`, one component per axis of the Gaussian, and the projected centres.
type ProjectedRows = (Vec3, Vec3, [Tensor<1>; 2]);

fn pinhole(
    [x, y, z]: [&Tensor<1>; 3],
    axes: &[Vec3; 3],
    camera: &Intrinsics,
    options: &RenderOptions,
) -> ProjectedRows {
    let held = |slope: Tensor<1>, size: usize, focal: f64, principal: f64| {
        let margin = options.jacobian_margin * size as f64 / (2.0 * focal);
        slope.clamp(-principal / focal - margin, (size as f64 - principal) / focal + margin)
    };
    let slope_x = held(x.clone() / z.clone(), camera.width, camera.fx, camera.cx);
    let slope_y = held(y.clone() / z.clone(), camera.height, camera.fy, camera.cy);
    let row = |image_axis: usize, slope: &Tensor<1>, focal: f64| -> Vec3 {
        axes.each_ref().map(|axis| (axis[image_axis].clone() - slope.clone() * axis[2].clone()) * focal / z.clone())
    };
    let (m0, m1) = (row(0, &slope_x, camera.fx), row(1, &slope_y, camera.fy));
    let mean2d = [x.clone() / z.clone() * camera.fx + camera.cx, y.clone() / z.clone() * camera.fy + camera.cy];
    (m0, m1, mean2d)
}

/// Equidistant projection without coefficients, with the `J` of gsplat's reference.
fn fisheye([x, y, z]: [&Tensor<1>; 3], axes: &[Vec3; 3], camera: &Intrinsics) -> ProjectedRows {
    assert_eq!(camera.distortion, [0.0; 8], "only the equidistant projection is implemented here");
    let (xx, yy, xy) = (x.clone().square(), y.clone().square(), x.clone() * y.clone());
    let squared = xx.clone() + yy.clone();
    let rho = squared.clone().sqrt();
    let per_rho = rho.clone().atan2(z.clone()) / rho;
    let inverse = (squared.clone() + z.clone().square()).recip();
    let (a, b) = (z.clone() * inverse.clone() / squared.clone(), per_rho.clone() / squared);
    let mixed = xy * (a.clone() - b.clone());
    let row = |focal: f64, [to_x, to_y]: [Tensor<1>; 2], across: &Tensor<1>| -> Vec3 {
        axes.each_ref().map(|axis| {
            let [ax, ay, az] = axis.clone();
            (to_x.clone() * ax + to_y.clone() * ay - across.clone() * inverse.clone() * az) * focal
        })
    };
    let own = |along: &Tensor<1>, across: &Tensor<1>| along.clone() * a.clone() + across.clone() * b.clone();
    let m0 = row(camera.fx, [own(&xx, &yy), mixed.clone()], x);
    let m1 = row(camera.fy, [mixed, own(&yy, &xx)], y);
    let mean2d = [x.clone() * per_rho.clone() * camera.fx + camera.cx, y.clone() * per_rho * camera.fy + camera.cy];
    (m0, m1, mean2d)
}

/// Projects all Gaussians.
pub fn project(
    [means, quats, scales]: [&Tensor<2>; 3],
    opacities: &Tensor<1>,
    pose: &Tensor<2>,
    camera: &Intrinsics,
    options: &RenderOptions,
) -> DenseEllipses {
    let mean = [0, 1, 2].map(|i| column(means, i));
    let pose_row = |row: usize| [0, 1, 2].map(|col| entry(pose, row, col));
    let [x, y, z] = [0, 1, 2].map(|row| dot(&pose_row(row), &mean) + entry(pose, row, 3));

    let r = rotations(quats);
    let scale = [0, 1, 2].map(|i| column(scales, i));
    // Columns of W R diag(s), one per axis of the Gaussian.
    let axes = [0, 1, 2].map(|axis: usize| {
        let world = [0, 1, 2].map(|row: usize| r[row][axis].clone() * scale[axis].clone());
        [0, 1, 2].map(|row| dot(&pose_row(row), &world))
    });
    let (m0, m1, mean2d) = match camera.model {
        CameraModel::Fisheye => fisheye([&x, &y, &z], &axes, camera),
        _ => pinhole([&x, &y, &z], &axes, camera, options),
    };
    let (xx, xy, yy) = (dot(&m0, &m0), dot(&m0, &m1), dot(&m1, &m1));
    let (a, c) = (xx.clone() + options.blur, yy.clone() + options.blur);
    let determinant = a.clone() * c - xy.clone().square();
    let opacity = if options.antialias {
        let sharp = xx * yy - xy.clone().square();
        let squared = (sharp / determinant.clone()).clamp_min(COMPENSATION_MIN * COMPENSATION_MIN);
        opacities.clone() * squared.sqrt()
    } else {
        opacities.clone()
    };
    DenseEllipses {
        mean2d,
        sigma_u: a.clone().sqrt(),
        shear: xy / a.clone(),
        sigma_v: (determinant / a).sqrt(),
        depth: z,
        opacity,
    }
}

/// Evaluates colours `[N, 3]` from spherical harmonics up to degree 2, `[N, K, 3]`.
pub fn evaluate_sh(sh: &Tensor<3>, means: &Tensor<2>, pose: &Tensor<2>) -> Tensor<2> {
    let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|col| entry(pose, row, col)));
    // The columns of the inverse are cross products of rows, divided by the determinant.
    let columns = [cross(&rows[1], &rows[2]), cross(&rows[2], &rows[0]), cross(&rows[0], &rows[1])];
    let determinant = dot(&rows[0], &columns[0]);
    let t = [0, 1, 2].map(|row| entry(pose, row, 3));
    let eye = [0, 1, 2].map(|axis: usize| {
        let along = columns.each_ref().map(|column| column[axis].clone());
        (dot(&along, &t) / determinant.clone()).neg()
    });
    let to_mean = [0, 1, 2].map(|axis| column(means, axis) - eye[axis].clone());
    let distance = dot(&to_mean, &to_mean).sqrt();
    let [x, y, z] = to_mean.map(|component| component / distance.clone());
    // Real spherical harmonics in the order and with the signs of Kerbl et al. 2023.
    let pi = std::f64::consts::PI;
    let (band1, band2) = ((3.0 / (4.0 * pi)).sqrt(), (15.0 / (4.0 * pi)).sqrt());
    let ones = x.clone() * 0.0 + 1.0;
    let basis = [
        ones.clone() * (1.0 / (4.0 * pi)).sqrt(),
        y.clone() * -band1,
        z.clone() * band1,
        x.clone() * -band1,
        x.clone() * y.clone() * band2,
        y.clone() * z.clone() * -band2,
        (z.clone().square() * 3.0 - ones) * ((5.0 / (16.0 * pi)).sqrt()),
        x.clone() * z * -band2,
        (x.square() - y.square()) * (band2 / 2.0),
    ];
    let [count, coefficients, _] = sh.dims();
    let mut colour = Tensor::zeros([count, 3], (&sh.device(), sh.dtype())) + 0.5;
    for (k, weight) in basis.into_iter().enumerate().take(coefficients) {
        let coefficient = sh.clone().slice([0..count, k..k + 1, 0..3]).squeeze_dim::<2>(1);
        colour = colour + coefficient * weight.unsqueeze_dim(1);
    }
    colour.clamp_min(0.0)
}

/// Rasterizes front to back. The order is computed on the host, because it has no gradient.
pub fn rasterize(
    ellipses: &DenseEllipses,
    features: &Tensor<2>,
    background: &Tensor<1>,
    camera: &Intrinsics,
    alpha_max: f64,
) -> DensePicture {
    let (device, dtype) = (features.device(), features.dtype());
    let pixels = camera.width * camera.height;
    let centres = |coordinate: fn(usize, usize) -> usize| -> Tensor<2> {
        let values: Vec<f64> = (0..pixels).map(|pixel| coordinate(pixel, camera.width) as f64 + 0.5).collect();
        Tensor::from_data(TensorData::new(values, [1, pixels]), (&device, dtype))
    };
    let depths = host(ellipses.depth.clone());
    let mut order: Vec<usize> = (0..depths.len()).collect();
    order.sort_by(|&a, &b| depths[a].total_cmp(&depths[b]));
    let order: Vec<i64> = order.into_iter().map(|i| i as i64).collect();
    let order = Tensor::<1, Int>::from_data(TensorData::new(order, [depths.len()]), &device);
    // [N, 1], front to back.
    let sorted = |t: &Tensor<1>| -> Tensor<2> { t.clone().select(0, order.clone()).unsqueeze_dim(1) };
    let dx = centres(|pixel, width| pixel % width) - sorted(&ellipses.mean2d[0]);
    let dy = centres(|pixel, width| pixel / width) - sorted(&ellipses.mean2d[1]);
    let u = dx.clone() / sorted(&ellipses.sigma_u);
    let v = (dy - sorted(&ellipses.shear) * dx) / sorted(&ellipses.sigma_v);
    let falloff = ((u.square() + v.square()) * -0.5).exp();
    let alphas = (falloff * sorted(&ellipses.opacity)).clamp_max(alpha_max);

    let features = features.clone().select(0, order.clone());
    let channels = features.dims()[1];
    let mut transmittance = Tensor::<2>::ones([1, pixels], (&device, dtype));
    let mut weights = Vec::with_capacity(depths.len());
    for layer in 0..depths.len() {
        let alpha = alphas.clone().slice([layer..layer + 1, 0..pixels]);
        weights.push(transmittance.clone() * alpha.clone());
        transmittance = transmittance * (alpha.neg() + 1.0);
    }
    let weights = Tensor::cat(weights, 0);
    let behind = transmittance.clone().transpose() * background.clone().reshape([1, channels]);
    DensePicture {
        colour: weights.clone().transpose().matmul(features) + behind,
        alpha: transmittance.reshape([pixels]).neg() + 1.0,
        depth: (weights * sorted(&ellipses.depth)).sum_dim(0).reshape([pixels]),
    }
}
