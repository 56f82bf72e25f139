//! What a render takes besides cameras and options: Gaussians, what they look like, and what is optional.

use burn::tensor::{DType, Tensor};

use crate::dials::Storage;
use crate::error::SplatError;
use crate::limits::Need;
use crate::options::RenderOptions;

/// Gaussians with activated parameters, one row each, all of one float type (f32; f64 on CPU devices) and on one device.
#[derive(Clone, Debug)]
pub struct Splats {
    /// `[N, 3]`: centres, world frame, scene units.
    pub means: Tensor<2>,
    /// `[N, 4]`: quaternions wxyz, world-from-Gaussian, of any non-zero length.
    pub rotations: Tensor<2>,
    /// `[N, 3]`: standard deviations along the rotated axes, scene units.
    pub scales: Tensor<2>,
    /// `[N]`: opacities, 0 to 1. One of exactly 0 is not drawn, and gets no gradient to grow by.
    pub opacities: Tensor<1>,
    /// Colours or features.
    pub colour: Colour,
}

impl Splats {
    /// The same with coefficients of spherical harmonics as `options` want them, once for many renders: see [`Colour::stored`].
    ///
    /// # Errors
    /// As [`Colour::stored`].
    pub fn stored(&self, options: &RenderOptions) -> Result<Self, SplatError> {
        Ok(Self { colour: self.colour.stored(options.coefficients)?, ..self.clone() })
    }
}

/// Optional inputs of a render.
#[derive(Clone, Debug, Default)]
pub struct Extras {
    /// `[C]`: what is seen through the Gaussians; zero if absent.
    pub background: Option<Tensor<1>>,
    /// A tracked `[N, 2]` leaf whose gradient becomes `∂L/∂mean2d` at the projected centres, summed over the cameras,
    /// per px. (Burn keeps no gradient of an inner tensor.) The densification threshold of the field, 2e-4, is per unit
    /// of normalised device coordinates: multiply by `[width / 2, height / 2]` before comparing.
    pub mean2d_probe: Option<Tensor<2>>,
    /// As `mean2d_probe`, but each pixel's contribution enters with its absolute value (AbsGrad, Ye et al. 2024).
    pub mean2d_abs_probe: Option<Tensor<2>>,
}

/// What each Gaussian looks like. Coefficients of spherical harmonics may be of half precision where everything else is f32 or
/// f64, see [`Colour::stored`].
#[derive(Clone, Debug)]
#[non_exhaustive]
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

/// The largest half-precision float.
const HALF_MAX: f32 = 65_504.0;

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

/// Checked coefficients without those above a degree; where there are none, as they are.
pub(crate) fn up_to_degree(sh: &Tensor<3>, degree: Option<usize>) -> Tensor<3> {
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
