//! What Gaussians look like: features, or spherical harmonics.

use burn::backend::Dispatch;
use burn::tensor::{DType, Tensor};

use crate::camera::Camera;
use crate::check::Reference;
use crate::dials::Storage;
use crate::error::SplatError;
use crate::limits::Need;
use crate::op::{Slot, SplatBackend};
use crate::options::RenderOptions;
use crate::project::{COLUMNS, ProjectSpec};
use crate::real::HALF_MAX;
use crate::shade::{ShadeInputs, sh_degree};
use crate::stages::{Projected, Splats};

/// What each Gaussian looks like. Coefficients of spherical harmonics may be of half precision where everything else is f32 or
/// f64, see [`Colour::stored`].
#[derive(Clone, Debug)]
pub enum Colour {
    /// Spherical-harmonics coefficients `[N, (degree+1)², 3]`, degree 0 to 4.
    SphericalHarmonics(Tensor<3>),
    /// Any features `[N, C]`, blended as they are.
    Features(Tensor<2>),
}

impl Colour {
    /// The same with coefficients of spherical harmonics stored in another way: once for a scene that is rendered many times,
    /// where [`RenderOptions::coefficients`](crate::RenderOptions::coefficients) does it in every render. [`Storage::Half`] halves
    /// the memory that they take, four fifths of a scene of degree 3, and what a GPU reads of it. [`Storage::Full`] changes nothing:
    /// what was rounded off does not come back. Features, which are not harmonics, stay as they are.
    ///
    /// Differentiable: gradients, at the rounded coefficients, are of the type of the unrounded ones.
    ///
    /// # Errors
    /// If the device has no tensors of half precision, as `burn-ndarray` and GPUs without the shading language's `f16`.
    pub fn stored(&self, storage: Storage) -> Result<Self, SplatError> {
        Ok(match (storage, self) {
            (Storage::Full, _) | (_, Self::Features(_)) => self.clone(),
            (Storage::Half, Self::SphericalHarmonics(sh)) => Self::SphericalHarmonics(halved(sh)?),
        })
    }

    /// The same without harmonics above a degree; `None` for all there are.
    pub(crate) fn up_to_degree(&self, degree: Option<usize>) -> Self {
        match self {
            Self::SphericalHarmonics(sh) => Self::SphericalHarmonics(up_to_degree(sh, degree)),
            Self::Features(features) => Self::Features(features.clone()),
        }
    }
}

/// Coefficients in half precision, the nearest ones, of at most [`HALF_MAX`].
fn halved(sh: &Tensor<3>) -> Result<Tensor<3>, SplatError> {
    if sh.dtype() == DType::F16 {
        return Ok(sh.clone());
    }
    if !sh.device().supports_dtype(DType::F16) {
        return Err(SplatError::Value {
            field: "coefficients",
            found: format!("Storage::Half for `sh` on {:?}", sh.device()),
            expected: "Storage::Full, for this device has no tensors of half precision",
        });
    }
    Ok(sh.clone().clamp(-HALF_MAX, HALF_MAX).cast(DType::F16))
}

/// Colours `[N, 3]` of Gaussians seen from a camera, from spherical harmonics `[N, (degree+1)², 3]`.
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn shade(sh: &Tensor<3>, means: &Tensor<2>, camera: &Camera) -> Result<Tensor<2>, SplatError> {
    // Without ellipses to decide who is visible the options are not read.
    shade_visible(sh, means, camera, (None, &RenderOptions::standard()))
}

/// The same for Gaussians that can show in the picture that `visible` was projected for, if it is given, and zero for all others.
fn shade_visible(
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
    let inputs = ShadeInputs {
        sh: sh.clone().into_dispatch(),
        means: means.clone().into_dispatch(),
        cam_from_world: camera.cam_from_world.clone().into_dispatch(),
    };
    let intrinsics = visible.map_or(camera.intrinsics, |visible| *visible.intrinsics());
    let visible = visible.map_or(Slot::Skip, |visible| Slot::Have(visible.packed().clone().into_dispatch()));
    let spec = ProjectSpec { intrinsics, options: *options };
    Ok(Tensor::from_dispatch(<Dispatch as SplatBackend>::shade(inputs, visible, spec)))
}

/// What each Gaussian shows a camera, `[N, C]`, whatever its colour is made of: [`shade`](fn@shade) for harmonics, and features as
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
        Colour::SphericalHarmonics(sh) => shade(&up_to_degree(sh, degree), &splats.means, camera),
        Colour::Features(features) => Ok(features.clone()),
    }
}

/// What each Gaussian shows in one picture, `[N, C]`: as [`colours`], without harmonics above `options.sh_degree`, and zero for
/// Gaussians whose ellipses in `projected` cannot show, whose harmonics are not read. `shade/` says which those are.
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
            shade_visible(&up_to_degree(sh, options.sh_degree), &splats.means, camera, (visible, options))
        }
        Colour::Features(features) => Ok(features.clone()),
    }
}

/// Checked coefficients without those above a degree; where there are none, as they are.
fn up_to_degree(sh: &Tensor<3>, degree: Option<usize>) -> Tensor<3> {
    match degree.map(|degree| (degree + 1) * (degree + 1)) {
        Some(coefficients) if coefficients < sh.dims()[1] => sh.clone().narrow(1, 0, coefficients),
        _ => sh.clone(),
    }
}

pub(crate) fn sh_need(sh: &Tensor<3>) -> Need {
    Need::numbers(
        "sh",
        sh.dims(),
        sh.dtype().size(),
        "use fewer Gaussians or a lower degree of the spherical harmonics",
    )
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
