//! The pixels that each Gaussian covers, for strategies that request `Signals::covered`.

use burn::tensor::Tensor;
use splat_op::{Camera, Colour, Extras, RenderOptions, SplatError, Splats, render_view};

/// `[N, 2]`: for each Gaussian the covered pixels, weighted by its share in the pixel's colour, and the same sum over wrong
/// pixels: those whose error, from `image − truth`, `[H, W, 3]`, exceeds the picture's mean.
///
/// The colour of pixel `p` is `Cₚ = Σᵢ wᵢₚ cᵢ`. With a mask `m` of pixels and `cᵢ` a feature, `∂/∂cᵢ Σₚ mₚ Cₚ = Σₚ mₚ wᵢₚ`.
/// That takes one more render with its backward pass, in which only the features are tracked.
pub(super) fn covered(
    splats: &Splats,
    camera: &Camera,
    options: &RenderOptions,
    (image, truth): (Tensor<3>, Tensor<3>),
) -> Result<Tensor<2>, SplatError> {
    let error = (image.inner() - truth).abs().mean_dim(2);
    let usual = error.clone().mean().reshape([1, 1, 1]).expand(error.shape());
    let wrong = error.greater(usual).float();
    let still = |values: &Tensor<2>| Tensor::from_inner(values.clone().inner());
    let features = Tensor::ones([splats.means.dims()[0], 2], &splats.means.device()).require_grad();
    let splats = Splats {
        means: still(&splats.means),
        rotations: still(&splats.rotations),
        scales: still(&splats.scales),
        opacities: Tensor::from_inner(splats.opacities.clone().inner()),
        colour: Colour::Features(features.clone()),
    };
    let cam_from_world = camera.cam_from_world.clone();
    let cam_from_world = if cam_from_world.device().is_autodiff() { cam_from_world.inner() } else { cam_from_world };
    let camera = Camera { cam_from_world, ..camera.clone() };
    let picture = render_view(&splats, &camera, &Extras::default(), &options.with_depth(false))?;
    let counted = Tensor::cat(vec![wrong.ones_like(), wrong], 2);
    let mut gradients = (picture.colour * Tensor::from_inner(counted)).sum().backward();
    let covered = features.grad_remove(&mut gradients);
    Ok(covered.unwrap_or_else(|| features.inner().zeros_like()))
}
