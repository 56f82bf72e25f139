//! Uncertainty (after Hanson et al. 2025, "PUP 3D-GS"): the Fisher information of each Gaussian's centre and size about all
//! photographs. Gaussians of little information can go. The picture shows information as brightness.
//!
//! The information is `Σ J Jᵀ` over pixels, `J` the derivatives of a pixel by the six numbers. A backward pass gives no single
//! pixel's derivatives. With random signs `v` the gradient `g` of `v · picture` has `E[g gᵀ] = Σ J Jᵀ`, so a few passes estimate it.
//! Run: `cargo run --release -p splat-gallery --example uncertainty -- uncertainty.png`.
use burn::tensor::{Device, Distribution, Tensor};
use splat_gallery::{SMALL, Shot, demo, picture, quality, save, shown, trained};
use splat_model::trainer::TrainConfig;
use splat_op::{Colour, SplatError, Splats};

/// Random signs for each photograph.
const PROBES: usize = 4;

/// The share of the Gaussians that is pruned.
const PRUNED: f64 = 0.5;

/// `[N, 6, 6]`: the information about centres, in units of the Gaussian's size, and logarithms of scales. Without the units large Gaussians,
/// such as the sky's, would count little.
fn information(scene: &Splats, shots: &[Shot], device: &Device) -> Result<Tensor<3>, SplatError> {
    let tracked = |tensor: &Tensor<2>| Tensor::<2>::from_inner(tensor.clone()).require_grad();
    let (means, log_scales) = (tracked(&scene.means), tracked(&scene.scales.clone().log()));
    let sizes = scene.scales.clone().mean_dim(1);
    let mut sum = Tensor::<3>::zeros([means.dims()[0], 6, 6], &device.clone().inner());
    for shot in shots.iter().flat_map(|shot| std::iter::repeat_n(shot, PROBES)) {
        let splats = Splats { means: means.clone(), scales: log_scales.clone().exp(), ..scene.clone() };
        let image = shown(&splats, &shot.camera)?.colour;
        let signs = Tensor::random(image.dims(), Distribution::Bernoulli(0.5), device) * 2.0 - 1.0;
        let gradients = (image * signs).sum().backward();
        let of = |tensor: &Tensor<2>| tensor.grad(&gradients).expect("both are tracked");
        let row = Tensor::cat(vec![of(&means) * sizes.clone(), of(&log_scales)], 1);
        sum = sum + row.clone().unsqueeze_dim::<3>(2) * row.unsqueeze_dim::<3>(1);
    }
    Ok(sum / PROBES as f64)
}

/// `[N]`: logarithms of the determinants of positive matrices `[N, K, K]`, by elimination.
fn log_determinant(matrices: Tensor<3>) -> Tensor<1> {
    let [count, size, _] = matrices.dims();
    let mut sum = Tensor::zeros([count], &matrices.device());
    let mut rest = matrices;
    for left in (0..size).rev() {
        let pivot = rest.clone().narrow(1, 0, 1).narrow(2, 0, 1);
        sum = sum + pivot.clone().clamp_min(1e-30).log().reshape([count]);
        if left > 0 {
            let (column, row) = (rest.clone().narrow(1, 1, left).narrow(2, 0, 1), rest.clone().narrow(1, 0, 1));
            rest =
                rest.narrow(1, 1, left).narrow(2, 1, left) - column * row.narrow(2, 1, left) / pivot.clamp_min(1e-30);
        }
    }
    sum
}

/// Mean dB over photographs without the Gaussians of the least scores `[N]`.
fn pruned(scene: &Splats, scores: &Tensor<1>, shots: &[Shot]) -> Result<f64, SplatError> {
    let count = scores.dims()[0];
    let kept = scores.clone().argsort_descending(0).narrow(0, 0, count - (PRUNED * count as f64) as usize);
    let of = |tensor: &Tensor<2>| tensor.clone().select(0, kept.clone());
    let colour = match &scene.colour {
        Colour::SphericalHarmonics(sh) => Colour::SphericalHarmonics(sh.clone().select(0, kept.clone())),
        other => other.clone(),
    };
    let opacities = scene.opacities.clone().select(0, kept.clone());
    let less = Splats {
        means: of(&scene.means),
        rotations: of(&scene.rotations),
        scales: of(&scene.scales),
        opacities,
        colour,
    };
    quality(shots, |shot| Ok((shown(&less, &shot.camera)?.colour, shot.image())))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::flex().autodiff();
    let (shots, points) = demo(SMALL, &device.clone().inner())?;
    let scene = trained(&shots, &points, TrainConfig { sh_degree: 0, ..TrainConfig::for_steps(400) })?;
    device.seed(1);
    let regular = Tensor::<2>::eye(6, &device.clone().inner()).unsqueeze::<3>() * 1e-8;
    let scores = log_determinant(information(&scene, &shots, &device)? + regular);
    let random = Tensor::random(scores.dims(), Distribution::Default, &device.clone().inner());
    let fisher = pruned(&scene, &scores, &shots)?;
    let by_opacity = pruned(&scene, &scene.opacities, &shots)?;
    let by_lot = pruned(&scene, &random, &shots)?;
    println!("{} Gaussians, half of them pruned", scores.dims()[0]);
    println!("by information {fisher:.2} dB, by opacity {by_opacity:.2} dB, by lot {by_lot:.2} dB");
    assert!(fisher > by_opacity && fisher > by_lot, "information is no better");

    let (low, high) = (scores.clone().min(), scores.clone().max());
    let shade = ((scores - low.clone()) / (high - low)).unsqueeze_dim::<2>(1).repeat_dim(1, 3);
    let map = shown(&Splats { colour: Colour::Features(shade), ..scene.clone() }, &shots[0].camera)?.colour;
    save(&picture()?, vec![shots[0].image(), shown(&scene, &shots[0].camera)?.colour, map])
}
