//! Gradients of a render with only some inputs tracked.

use burn::tensor::{DType, Device, Tensor};
use splat_op::{Camera, Colour, Extras, RenderOptions, Splats, render};

use crate::random::Random;
use crate::scene::{Scene, host, tensor};

/// Inputs of a render that can be tracked, in the order of [`gradients_of`].
pub const INPUTS: [&str; 9] =
    ["means", "rotations", "scales", "opacities", "sh", "pose", "background", "mean2d_probe", "mean2d_abs_probe"];

/// Returns the gradient of each of [`INPUTS`], `None` where `tracked` is false. The loss sums all outputs with
/// random weights that are equal in every call. The first of the `cameras` is the scene's camera, and the others move away from it.
pub fn gradients_of(
    scene: &Scene,
    cameras: usize,
    tracked: [bool; 9],
    options: &RenderOptions,
    (device, dtype): &(Device, DType),
) -> [Option<Vec<f64>>; 9] {
    let (device, dtype, count) = (device.clone().autodiff(), *dtype, scene.count());
    macro_rules! leaf {
        ($index:literal, $values:expr, $shape:expr) => {{
            let tensor = tensor($values, $shape, &device, dtype);
            if tracked[$index] { tensor.require_grad() } else { tensor }
        }};
    }
    let means: Tensor<2> = leaf!(0, &scene.means, [count, 3]);
    let rotations: Tensor<2> = leaf!(1, &scene.quats, [count, 4]);
    let scales: Tensor<2> = leaf!(2, &scene.scales, [count, 3]);
    let opacities: Tensor<1> = leaf!(3, &scene.opacities, [count]);
    let sh: Tensor<3> = leaf!(4, &scene.sh, [count, scene.coefficients(), 3]);
    let pose: Tensor<2> = leaf!(5, &scene.pose, [3, 4]);
    let background: Tensor<1> = leaf!(6, &scene.background, [3]);
    let probe: Tensor<2> = leaf!(7, &vec![0.0; 2 * count], [count, 2]);
    let abs_probe: Tensor<2> = leaf!(8, &vec![0.0; 2 * count], [count, 2]);
    let splats = Splats {
        means: means.clone(),
        rotations: rotations.clone(),
        scales: scales.clone(),
        opacities: opacities.clone(),
        colour: Colour::SphericalHarmonics(sh.clone()),
    };
    let views: Vec<Camera> = (0..cameras)
        .map(|view| {
            // The shift is an integer times a power of two, and therefore equal in both float types.
            let shift = 0.125 * view as f64;
            let mut sideways = vec![0.0; 12];
            sideways[3] = shift;
            let cam_from_world = pose.clone() + tensor(&sideways, [3, 4], &device, dtype);
            let intrinsics = scene.intrinsics.with_focal(scene.intrinsics.fx * (1.0 + shift), scene.intrinsics.fy);
            Camera { intrinsics, cam_from_world }
        })
        .collect();
    let extras = Extras::default()
        .with_background(background.clone())
        .with_mean2d_probe(probe.clone())
        .with_mean2d_abs_probe(abs_probe.clone());
    let out = render(&splats, &views, &extras, options).expect("a valid scene");
    let mut random = Random::new(5);
    let mut weighted = |t: Tensor<4>| {
        let shape = t.dims();
        let weights = random.fill(shape.iter().product(), -1.0, 1.0);
        let weights: Vec<f64> = weights.into_iter().map(|weight| f64::from(weight as f32)).collect();
        (t * tensor(&weights, shape, &device, dtype)).sum()
    };
    let loss = weighted(out.colour) + weighted(out.alpha) + weighted(out.depth.expect("asked for"));
    let grads = loss.backward();
    [
        means.grad(&grads).map(host),
        rotations.grad(&grads).map(host),
        scales.grad(&grads).map(host),
        opacities.grad(&grads).map(host),
        sh.grad(&grads).map(host),
        pose.grad(&grads).map(host),
        background.grad(&grads).map(host),
        probe.grad(&grads).map(host),
        abs_probe.grad(&grads).map(host),
    ]
}
