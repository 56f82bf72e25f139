//! How long this machine takes for a step, compared with the machine on which costs were measured.

use std::time::Instant;

use burn::tensor::{Device, Tensor};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, SplatError, Splats, render_view};

/// Time of the reference work on the machine of `docs/EFFECTS.md`, ms.
const REFERENCE_MS: f64 = 2.3;

/// Number of times the work is done; the least time counts.
const REPEATS: usize = 9;

/// Gaussians along each side of the reference scene.
const SIDE: usize = 16;

/// Renders a small scene and its gradients on the CPU a few times and returns the time that takes relative to that on the machine on
/// which costs were measured: 2 on a machine that is half as fast. Takes about 20 ms.
///
/// # Errors
/// None expected: those of a render.
pub fn slowness() -> Result<f64, SplatError> {
    let device = Device::flex();
    let camera = Camera::new(Intrinsics::centred(160, 120, 140.0), &glam::DAffine3::IDENTITY, &device);
    let camera = Camera { cam_from_world: Tensor::from_inner(camera.cam_from_world), ..camera };
    let least = (0..REPEATS)
        .map(|_| work_ms(&camera, &device.clone().autodiff()))
        .try_fold(f64::INFINITY, |least, ms| ms.map(|ms| least.min(ms)))?;
    Ok(least / REFERENCE_MS)
}

/// The time of one render with its gradients, ms.
fn work_ms(camera: &Camera, device: &Device) -> Result<f64, SplatError> {
    let count = SIDE * SIDE * SIDE;
    let place = |i: usize| i as f32 / SIDE as f32 - 0.5;
    let means: Vec<f32> = (0..count)
        .flat_map(|i| [4.0 * place(i % SIDE), 3.0 * place(i / SIDE % SIDE), 4.0 + place(i / (SIDE * SIDE))])
        .collect();
    let means = Tensor::<1>::from_floats(means.as_slice(), device).reshape([count, 3]).require_grad();
    let splats = Splats {
        rotations: Tensor::from_floats([[1.0, 0.1, 0.2, 0.3]], device).repeat_dim(0, count),
        scales: Tensor::from_floats([[0.2, 0.1, 0.05]], device).repeat_dim(0, count),
        opacities: Tensor::full([count], 0.2, device),
        colour: Colour::SphericalHarmonics(Tensor::full([count, 4, 3], 0.1, device).require_grad()),
        means,
    };
    let start = Instant::now();
    let picture = render_view(&splats, camera, &Extras::default(), &RenderOptions::standard())?;
    drop(picture.colour.sum().backward());
    Ok(start.elapsed().as_secs_f64() * 1e3)
}

#[cfg(test)]
mod tests;
