//! Render and gradients of a scene by the operation, on any device and float type.

use burn::tensor::{DType, Device, Tensor};
use splat_op::{Camera, Colour, Extras, Panorama, RawSplats, Splats, activate, project, render_view};

use crate::scene::{HardScene, OutputWeights, Paint};
use crate::tensors::{Named, host, leaf, tensor};

/// Names of the gradients, in the order of [`Outputs::gradients`]; those before [`OF_NO_SPLAT`] have a row per Gaussian.
pub const GRADIENTS: [&str; 8] =
    ["means", "rotations", "scales", "opacities", "colours", "mean2d", "pose", "background"];

/// Index in [`GRADIENTS`] of the first gradient that has no row per Gaussian.
pub const OF_NO_SPLAT: usize = 6;

/// Outputs and gradients of a render.
#[derive(Clone, Debug)]
pub struct Outputs {
    /// `image alpha depth`, a row per pixel.
    pub pictures: Vec<Named>,
    /// See [`GRADIENTS`].
    pub gradients: Vec<Named>,
}

impl Outputs {
    /// Pictures, then gradients.
    pub fn tensors(&self) -> impl Iterator<Item = &Named> {
        self.pictures.iter().chain(&self.gradients)
    }

    /// Mutable references to the tensors of [`Self::tensors`].
    pub fn tensors_mut(&mut self) -> impl Iterator<Item = &mut Named> {
        self.pictures.iter_mut().chain(&mut self.gradients)
    }

    /// Adds names and columns to the values of one render.
    pub fn new(scene: &HardScene, pictures: [Vec<f64>; 3], gradients: [Vec<f64>; GRADIENTS.len()]) -> Self {
        let colours = scene.colour_columns();
        let columns = [3, 4, 3, 1, colours, 2, 4, scene.channels()];
        let named = |((name, columns), values)| Named { name, columns, values };
        Self {
            pictures: ["image", "alpha", "depth"]
                .into_iter()
                .zip([scene.channels(), 1, 1])
                .zip(pictures)
                .map(named)
                .collect(),
            gradients: GRADIENTS.into_iter().zip(columns).zip(gradients).map(named).collect(),
        }
    }
}

/// Leaves of a scene, tracked on an autodiff device, and the splats made of them.
struct Leaves {
    splats: Splats,
    scales: Tensor<2>,
    opacities: Tensor<1>,
    colours: Tensor<2>,
    camera: Camera,
}

fn leaves(scene: &HardScene, device: &Device, dtype: DType) -> Leaves {
    let count = scene.count();
    let scales: Tensor<2> = leaf(&scene.scales, [count, 3], device, dtype);
    let opacities: Tensor<1> = leaf(&scene.opacities, [count], device, dtype);
    let colours: Tensor<2> = leaf(&scene.colours, [count, scene.colour_columns()], device, dtype);
    let (means, rotations) =
        (leaf(&scene.means, [count, 3], device, dtype), leaf(&scene.quats, [count, 4], device, dtype));
    let (activated_scales, activated_opacities) = if scene.stored {
        // The activation of `splat_model::Gaussians`. These scenes do not test colours.
        let raw = RawSplats {
            means: means.clone(),
            rotations: rotations.clone(),
            log_scales: scales.clone(),
            logit_opacities: opacities.clone(),
            sh: Tensor::zeros([count, 1, 3], (device, dtype)),
        };
        activate::activated(&raw, None).expect("shapes that the scene has")
    } else {
        (scales.clone(), opacities.clone())
    };
    let splats = Splats {
        means,
        rotations,
        scales: activated_scales,
        opacities: activated_opacities,
        colour: match scene.paint {
            Paint::Features(_) => Colour::Features(colours.clone()),
            Paint::Harmonics(degree) => {
                Colour::SphericalHarmonics(colours.clone().reshape([count, (degree + 1) * (degree + 1), 3]))
            }
        },
    };
    let cam_from_world = leaf(&scene.pose, [3, 4], device, dtype);
    Leaves { splats, scales, opacities, colours, camera: Camera { intrinsics: scene.intrinsics, cam_from_world } }
}

/// Renders and differentiates a scene. `device` has no autodiff.
///
/// # Panics
/// If the operation refuses the scene.
pub fn evaluate(scene: &HardScene, weights: &OutputWeights, device: &Device, dtype: DType) -> Outputs {
    let device = device.clone().autodiff();
    let Leaves { splats, scales, opacities, colours, camera } = leaves(scene, &device, dtype);
    let background: Tensor<1> = leaf(&scene.background, [scene.channels()], &device, dtype);
    let probe = Tensor::zeros([scene.count(), 2], (&device, dtype)).require_grad();
    let extras = Extras::default().with_background(background.clone()).with_mean2d_probe(probe.clone());
    let out = match scene.panorama {
        true => panorama(scene, &device).render(&splats, &camera.cam_from_world, &extras, &scene.options),
        false => render_view(&splats, &camera, &extras, &scene.options),
    };
    let out = out.unwrap_or_else(|error| panic!("{}: {error}", scene.label));
    let depth = out.depth.expect("depth was asked for");

    let [height, width] = [scene.intrinsics.height, scene.intrinsics.width];
    let weight = |values: &[f64], channels| tensor(values, [height, width, channels], &device, dtype);
    let loss = (out.colour.clone() * weight(&weights.image, scene.channels())).sum()
        + (out.alpha.clone() * weight(&weights.alpha, 1)).sum()
        + (depth.clone() * weight(&weights.depth, 1)).sum();
    let grads = loss.backward();
    // Burn has no gradients for a scene without Gaussians.
    macro_rules! of {
        ($leaf:expr) => {
            $leaf.grad(&grads).map(host).unwrap_or_default()
        };
    }
    let gradients = [
        of!(splats.means),
        of!(splats.rotations),
        of!(scales),
        of!(opacities),
        of!(colours),
        of!(probe),
        of!(camera.cam_from_world),
        of!(background),
    ];
    Outputs::new(scene, [host(out.colour), host(out.alpha), host(depth)], gradients)
}

fn panorama(scene: &HardScene, device: &Device) -> Panorama {
    let size = &scene.intrinsics;
    Panorama::new(size.width, size.height, device).unwrap_or_else(|error| panic!("{}: {error}", scene.label))
}

/// Indices of the Gaussians that the projection culls, on all faces of a panorama.
pub fn culled(scene: &HardScene, device: &Device, dtype: DType) -> Vec<usize> {
    let Leaves { splats, camera, .. } = leaves(scene, device, dtype);
    let cameras = match scene.panorama {
        true => panorama(scene, device).faces(&camera.cam_from_world).to_vec(),
        false => vec![camera],
    };
    let depths = cameras.iter().map(|camera| {
        let projected = project(&splats, camera, &Extras::default(), &scene.options)
            .unwrap_or_else(|error| panic!("{}: {error}", scene.label));
        host(projected.ellipses().depth)
    });
    let depths: Vec<Vec<f64>> = depths.collect();
    (0..scene.count()).filter(|&i| depths.iter().all(|depths| depths[i] == 0.0)).collect()
}

/// The opacities after the projection, in f64: compensated, if the scene's options say so.
pub fn compensated_opacities(scene: &HardScene) -> Vec<f64> {
    let Leaves { splats, camera, .. } = leaves(scene, &Device::flex(), DType::F64);
    let projected = project(&splats, &camera, &Extras::default(), &scene.options)
        .unwrap_or_else(|error| panic!("{}: {error}", scene.label));
    host(projected.ellipses().opacity)
}
