//! A scene on the host in f64, and its render with all outputs and gradients on any device and float type.

use burn::tensor::{DType, Device, Tensor};
use splat_hard_cases::tensors::leaf;
pub use splat_hard_cases::tensors::{Named, host, tensor};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, evaluate_sh, project, render};

use crate::random::Random;

/// Activated parameters, row-major, and a camera.
#[derive(Clone, Debug)]
pub struct Scene {
    pub means: Vec<f64>,
    pub quats: Vec<f64>,
    pub scales: Vec<f64>,
    pub opacities: Vec<f64>,
    pub sh: Vec<f64>,
    pub background: Vec<f64>,
    /// Pose, camera from world, `[3, 4]`.
    pub pose: Vec<f64>,
    pub intrinsics: Intrinsics,
}

/// Weights of the loss `Σ w·out` over image, alpha and depth.
#[derive(Clone, Debug)]
pub struct LossWeights {
    pub image: Vec<f64>,
    pub alpha: Vec<f64>,
    pub depth: Vec<f64>,
}

/// Stages, pictures and gradients of a render.
#[derive(Clone, Debug)]
pub struct RenderOutputs {
    /// Outputs per Gaussian: `means2d depths conics colors`.
    pub stages: Vec<Named>,
    /// Outputs per pixel: `image alpha depth`.
    pub pictures: Vec<Named>,
    /// Gradients of `means quats scales opacities sh means2d viewmat background`.
    pub gradients: Vec<Named>,
}

/// Tensors of a scene.
pub struct SceneTensors {
    pub splats: Splats,
    pub sh: Tensor<3>,
    pub camera: Camera,
    pub background: Tensor<1>,
}

impl Scene {
    /// Creates `count` Gaussians in and around the view of a camera that is rotated and moved a little.
    pub fn random(random: &mut Random, count: usize, degree: usize, intrinsics: Intrinsics) -> Self {
        let slope = intrinsics.width as f64 / (2.0 * intrinsics.fx);
        let mut means = Vec::with_capacity(3 * count);
        for _ in 0..count {
            let z = random.between(2.0, 6.0);
            means.extend([random.between(-1.2, 1.2) * slope * z, random.between(-1.2, 1.2) * slope * z, z]);
        }
        let [a, b] = [0.06_f64, -0.04];
        let (turn_y, turn_x) = ([a.cos(), a.sin()], [b.cos(), b.sin()]);
        let pose = vec![
            turn_y[0],
            0.0,
            turn_y[1],
            0.05,
            turn_x[1] * turn_y[1],
            turn_x[0],
            -turn_x[1] * turn_y[0],
            -0.03,
            -turn_x[0] * turn_y[1],
            turn_x[1],
            turn_x[0] * turn_y[0],
            0.1,
        ];
        Self {
            means,
            quats: random.fill(4 * count, -1.0, 1.0),
            scales: random.fill(3 * count, 0.05, 0.5),
            opacities: random.fill(count, 0.2, 0.95),
            sh: random.fill(3 * count * (degree + 1) * (degree + 1), -0.6, 0.6),
            background: random.fill(3, 0.0, 1.0),
            pose,
            intrinsics,
        }
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.opacities.len()
    }

    /// Number of SH coefficients per channel.
    pub fn coefficients(&self) -> usize {
        self.sh.len() / (3 * self.count())
    }

    /// Returns the camera z of every centre.
    pub fn camera_z(&self) -> Vec<f64> {
        let p = &self.pose;
        self.means.chunks_exact(3).map(|m| p[8] * m[0] + p[9] * m[1] + p[10] * m[2] + p[11]).collect()
    }

    /// Creates the tensors of the scene, tracked if the device records gradients.
    pub fn tensors(&self, device: &Device, dtype: DType) -> SceneTensors {
        let count = self.count();
        let sh = leaf(&self.sh, [count, self.coefficients(), 3], device, dtype);
        SceneTensors {
            splats: Splats {
                means: leaf(&self.means, [count, 3], device, dtype),
                rotations: leaf(&self.quats, [count, 4], device, dtype),
                scales: leaf(&self.scales, [count, 3], device, dtype),
                opacities: leaf(&self.opacities, [count], device, dtype),
                colour: Colour::SphericalHarmonics(sh.clone()),
            },
            sh,
            camera: Camera { intrinsics: self.intrinsics, cam_from_world: leaf(&self.pose, [3, 4], device, dtype) },
            background: leaf(&self.background, [self.background.len()], device, dtype),
        }
    }
}

impl LossWeights {
    /// Creates random weights from -1 to 1.
    pub fn random(random: &mut Random, intrinsics: &Intrinsics) -> Self {
        let pixels = intrinsics.width * intrinsics.height;
        let mut fill = |count| random.fill(count, -1.0, 1.0);
        Self { image: fill(3 * pixels), alpha: fill(pixels), depth: fill(pixels) }
    }
}

/// Renders and differentiates a scene. `options.depth` must be set. `device` has no autodiff.
pub fn evaluate(
    scene: &Scene,
    weights: &LossWeights,
    options: &RenderOptions,
    device: &Device,
    dtype: DType,
) -> RenderOutputs {
    let device = device.clone().autodiff();
    let SceneTensors { splats, sh, camera, background } = scene.tensors(&device, dtype);
    let probe = Tensor::zeros([scene.count(), 2], (&device, dtype)).require_grad();
    let extras = Extras::default().with_background(background.clone()).with_mean2d_probe(probe.clone());
    let out = render(&splats, std::slice::from_ref(&camera), &extras, options).expect("a valid scene");
    let depth = out.depth.expect("depth was asked for");

    let [height, width] = [scene.intrinsics.height, scene.intrinsics.width];
    let weight = |values: &[f64], channels| tensor(values, [1, height, width, channels], &device, dtype);
    let loss = (out.colour.clone() * weight(&weights.image, 3)).sum()
        + (out.alpha.clone() * weight(&weights.alpha, 1)).sum()
        + (depth.clone() * weight(&weights.depth, 1)).sum();
    let grads = loss.backward();

    let named = |name, columns, values| Named { name, columns, values };
    let gradients = vec![
        named("g_means", 3, host(splats.means.grad(&grads).expect("tracked"))),
        named("g_quats", 4, host(splats.rotations.grad(&grads).expect("tracked"))),
        named("g_scales", 3, host(splats.scales.grad(&grads).expect("tracked"))),
        named("g_opacities", 1, host(splats.opacities.grad(&grads).expect("tracked"))),
        named("g_sh", 3 * scene.coefficients(), host(sh.grad(&grads).expect("tracked"))),
        named("g_means2d", 2, host(probe.grad(&grads).expect("tracked"))),
        named("g_viewmat", 4, host(camera.cam_from_world.grad(&grads).expect("tracked"))),
        named("g_background", 3, host(background.grad(&grads).expect("tracked"))),
    ];
    let pictures = vec![
        named("out_image", 3, host(out.colour)),
        named("out_alpha", 1, host(out.alpha)),
        named("out_depth", 1, host(depth)),
    ];
    RenderOutputs { stages: stages(scene, options, &device.inner(), dtype), pictures, gradients }
}

/// Computes the outputs of the stages before rasterization.
fn stages(scene: &Scene, options: &RenderOptions, device: &Device, dtype: DType) -> Vec<Named> {
    let SceneTensors { splats, sh, camera, .. } = scene.tensors(device, dtype);
    let ellipses = project(&splats, &camera, &Extras::default(), options).expect("a valid scene").ellipses();
    let colours = evaluate_sh(&sh, &splats.means, &camera).expect("a valid scene");
    let (sigma_u, shear, sigma_v) = (host(ellipses.sigma_u), host(ellipses.shear), host(ellipses.sigma_v));
    let conics = sigma_u.iter().zip(&shear).zip(&sigma_v).flat_map(|((u, k), v)| conic(*u, *k, *v)).collect();
    vec![
        Named { name: "out_means2d", columns: 2, values: host(ellipses.mean2d) },
        Named { name: "out_depths", columns: 1, values: host(ellipses.depth) },
        Named { name: "out_conics", columns: 3, values: conics },
        Named { name: "out_colors", columns: 3, values: host(colours) },
    ]
}

/// Returns the inverse covariance `(a, b, c)` of a factor.
pub fn conic(sigma_u: f64, shear: f64, sigma_v: f64) -> [f64; 3] {
    let (variance_u, variance_v) = (sigma_u * sigma_u, sigma_v * sigma_v);
    [1.0 / variance_u + shear * shear / variance_v, -shear / variance_v, 1.0 / variance_v]
}
