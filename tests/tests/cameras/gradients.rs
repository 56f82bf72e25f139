//! Gradients of all inputs of a render against differences, in f64.

use super::*;

/// Values of a scene's tensors, in the order of [`Self::NAMES`].
#[derive(Clone)]
pub struct Inputs {
    values: [Vec<f64>; 7],
    colour_shape: [usize; 3],
}

impl Inputs {
    const NAMES: [&str; 7] = ["means", "rotations", "scales", "opacities", "harmonics", "pose", "background"];

    pub fn new(of: &[ExactGaussian], pose: &DAffine3, random: &mut Random) -> Self {
        let at = f64s();
        let Splats { means, rotations, scales, opacities, .. } = splats(of, &at);
        let harmonics = random.fill(of.len() * 12, -0.4, 0.4);
        let background = vec![0.2, 0.5, 0.7];
        let values =
            [host(means), host(rotations), host(scales), host(opacities), harmonics, pose_rows(pose), background];
        Self { values, colour_shape: [of.len(), 4, 3] }
    }

    fn tensors(&self, device: &Device) -> (Splats, Tensor<3>, Tensor<2>, Extras) {
        let n = self.colour_shape[0];
        let leaf = |i: usize, width: usize| {
            let tensor: Tensor<2> = tensor(&self.values[i], [self.values[i].len() / width, width], device, DType::F64);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        let harmonics: Tensor<3> = tensor(&self.values[4], self.colour_shape, device, DType::F64);
        let harmonics = if device.is_autodiff() { harmonics.require_grad() } else { harmonics };
        let row = |i: usize, count: usize| {
            let tensor: Tensor<1> = tensor(&self.values[i], [count], device, DType::F64);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        let splats = Splats {
            means: leaf(0, 3),
            rotations: leaf(1, 4),
            scales: leaf(2, 3),
            opacities: row(3, n),
            colour: Colour::SphericalHarmonics(harmonics.clone()),
        };
        (splats, harmonics, leaf(5, 4), Extras::default().with_background(row(6, 3)))
    }
}

/// Compares gradients of a loss over pictures of `channels` planes with differences of the fourth order.
pub fn check_gradients(inputs: &Inputs, render: impl Fn(&Splats, &Tensor<2>, &Extras) -> Rendered<3>) {
    let loss = |inputs: &Inputs, device: &Device| {
        let (splats, harmonics, pose, extras) = inputs.tensors(device);
        let found = render(&splats, &pose, &extras);
        let planes: Tensor<3> = Tensor::cat(vec![found.colour, found.alpha, found.depth.expect("asked for")], 2);
        let weights = Random::new(9).fill(planes.dims().iter().product(), -1.0, 1.0);
        let weights: Tensor<3> = tensor(&weights, planes.dims(), device, DType::F64);
        ((planes * weights).sum(), splats, harmonics, pose, extras)
    };
    let (value, splats, harmonics, pose, extras) = loss(inputs, &Device::flex().autodiff());
    let grads = value.backward();
    let background = extras.background.expect("given");
    let found = [
        host(splats.means.grad(&grads).expect("tracked")),
        host(splats.rotations.grad(&grads).expect("tracked")),
        host(splats.scales.grad(&grads).expect("tracked")),
        host(splats.opacities.grad(&grads).expect("tracked")),
        host(harmonics.grad(&grads).expect("tracked")),
        host(pose.grad(&grads).expect("tracked")),
        host(background.grad(&grads).expect("tracked")),
    ];
    for (input, found) in found.iter().enumerate() {
        let most = found.iter().fold(1e-3_f64, |most, value| most.max(value.abs()));
        for (i, found) in found.iter().enumerate() {
            let step = 1e-4 * inputs.values[input][i].abs().max(0.1);
            let at = |steps: f64| {
                let mut moved = inputs.clone();
                moved.values[input][i] += steps * step;
                host(loss(&moved, &Device::flex()).0)[0]
            };
            let expected = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step);
            let error = (found - expected).abs();
            assert!(error <= 2e-6 * most, "{}[{i}]: {found} instead of {expected}", Inputs::NAMES[input]);
        }
    }
}
