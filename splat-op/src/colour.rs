//! From what Gaussians look like to what each shows a camera.

use burn::backend::Dispatch;
use burn::tensor::Tensor;

use crate::backend::stages::SplatBackend;
use crate::camera::Camera;
use crate::check::Reference;
use crate::error::SplatError;
use crate::options::RenderOptions;
use crate::project::{COLUMNS, ProjectSpec};
use crate::sh::{Shading, sh_degree};
use crate::splats::{Colour, Splats, sh_need, up_to_degree};
use crate::stages::Projected;

/// Colours `[N, 3]` of Gaussians seen from a camera, from spherical harmonics `[N, (degree+1)², 3]`.
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn evaluate_sh(sh: &Tensor<3>, means: &Tensor<2>, camera: &Camera) -> Result<Tensor<2>, SplatError> {
    // Without ellipses to decide who is visible the options are not read.
    sh_visible(sh, means, camera, (None, &RenderOptions::standard()))
}

/// The same for Gaussians that can show in the picture that `visible` was projected for, if it is given, and zero for all others.
fn sh_visible(
    sh: &Tensor<3>,
    means: &Tensor<2>,
    camera: &Camera,
    (visible, options): (Option<&Projected>, &RenderOptions),
) -> Result<Tensor<2>, SplatError> {
    let reference = Reference::new(means)?;
    let count = means.dims()[0];
    reference.check("means", means, [None, Some(3)], "[N, 3]")?;
    reference.check("cam_from_world", &camera.cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
    check_sh(&reference, sh, count)?;
    reference.check_fits(&[sh_need(sh)])?;
    if let Some(visible) = visible {
        reference.check("projected", visible.packed(), [Some(count), Some(COLUMNS)], "[N, 7]")?;
    }
    let inputs = Shading {
        sh: sh.clone().into(),
        means: means.clone().into(),
        cam_from_world: camera.cam_from_world.clone().into(),
    };
    let intrinsics = visible.map_or(camera.intrinsics, |visible| *visible.intrinsics());
    let visible = visible.map(|visible| visible.packed().clone().into_dispatch());
    let spec = ProjectSpec { intrinsics, options: *options };
    Ok(Tensor::from_dispatch(<Dispatch as SplatBackend>::evaluate_sh(inputs, visible.into(), spec)))
}

/// What each Gaussian shows a camera, `[N, C]`, whatever its colour is made of: [`evaluate_sh`](fn@evaluate_sh) for harmonics, and features as
/// they are.
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn colours(splats: &Splats, camera: &Camera) -> Result<Tensor<2>, SplatError> {
    colours_up_to(splats, camera, None)
}

/// The same without harmonics above a degree; `None` for all there are.
///
/// # Errors
/// As [`colours`].
pub fn colours_up_to(splats: &Splats, camera: &Camera, degree: Option<usize>) -> Result<Tensor<2>, SplatError> {
    match &splats.colour {
        Colour::SphericalHarmonics(sh) => evaluate_sh(&up_to_degree(sh, degree), &splats.means, camera),
        Colour::Features(features) => Ok(features.clone()),
    }
}

/// What each Gaussian shows in one picture, `[N, C]`: as [`colours`], without harmonics above `options.sh_degree`, and zero for
/// Gaussians whose ellipses in `projected` cannot show, whose harmonics are not read. `sh/` says which those are.
///
/// The zeros are constants: no gradient flows through them. A render whose pixels look along their rays needs the colours of
/// all, and gets them.
///
/// # Errors
/// As [`colours`]; if `projected` has another number of Gaussians.
pub fn visible_colours(
    splats: &Splats,
    camera: &Camera,
    projected: &Projected,
    options: &RenderOptions,
) -> Result<Tensor<2>, SplatError> {
    match &splats.colour {
        // Rays may meet Gaussians whose ellipses miss the picture.
        Colour::SphericalHarmonics(sh) => {
            let visible = (!options.along_rays()).then_some(projected);
            sh_visible(&up_to_degree(sh, options.sh_degree), &splats.means, camera, (visible, options))
        }
        Colour::Features(features) => Ok(features.clone()),
    }
}

fn check_sh(reference: &Reference, sh: &Tensor<3>, count: usize) -> Result<(), SplatError> {
    const EXPECTED: &str = "[N, (degree+1)², 3] with degree 0 to 4";
    reference.check_or_half("sh", sh, [Some(count), None, Some(3)], EXPECTED)?;
    match sh_degree(sh.dims()[1]) {
        Some(_) => Ok(()),
        None => Err(SplatError::Shape {
            name: "sh",
            found: sh.dims().to_vec(),
            expected: EXPECTED,
            hint: "give 1, 4, 9, 16 or 25 coefficients per channel".into(),
        }),
    }
}
