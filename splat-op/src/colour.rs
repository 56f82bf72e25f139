//! What Gaussians look like: features, or spherical harmonics of one degree or of two.

use burn::backend::Dispatch;
use burn::tensor::{DType, Tensor};

use crate::camera::Camera;
use crate::check::Reference;
use crate::dials::Storage;
use crate::error::SplatError;
use crate::limits::Need;
use crate::op::SplatBackend;
use crate::shade::{ShadeInputs, sh_degree};
use crate::stages::Splats;

/// What each Gaussian looks like. Coefficients of spherical harmonics may be of half precision where everything else is f32 or
/// f64, see [`Colour::stored`].
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one per scene, and a box would show in every use of it")]
pub enum Colour {
    /// Spherical-harmonics coefficients `[N, (degree+1)², 3]`, degree 0 to 4.
    SphericalHarmonics(Tensor<3>),
    /// The same where the last Gaussians are of one colour from everywhere: as if all their higher coefficients were zero, but
    /// those take neither memory nor time.
    Mixed {
        /// `[M, (degree+1)², 3]`: of the first `M` Gaussians, degree 0 to 4.
        directional: Tensor<3>,
        /// `[N − M, 1, 3]`: of the others, degree 0.
        matte: Tensor<3>,
    },
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
            (Storage::Half, Self::SphericalHarmonics(sh)) => Self::SphericalHarmonics(halved("sh", sh)?),
            (Storage::Half, Self::Mixed { directional, matte }) => {
                Self::Mixed { directional: halved("directional", directional)?, matte: halved("matte", matte)? }
            }
        })
    }

    /// The same without harmonics above a degree; `None` for all there are.
    pub(crate) fn up_to_degree(&self, degree: Option<usize>) -> Self {
        match self {
            Self::SphericalHarmonics(sh) => Self::SphericalHarmonics(up_to_degree(sh, degree)),
            Self::Mixed { directional, matte } => {
                Self::Mixed { directional: up_to_degree(directional, degree), matte: matte.clone() }
            }
            Self::Features(features) => Self::Features(features.clone()),
        }
    }
}

/// The largest half-precision float.
const HALF_MAX: f32 = 65_504.0;

/// Coefficients in half precision, the nearest ones, of at most [`HALF_MAX`].
fn halved(name: &'static str, sh: &Tensor<3>) -> Result<Tensor<3>, SplatError> {
    if sh.dtype() == DType::F16 {
        return Ok(sh.clone());
    }
    if !sh.device().supports_dtype(DType::F16) {
        return Err(SplatError::Value {
            field: "coefficients",
            found: format!("Storage::Half for `{name}` on {:?}", sh.device()),
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
    let reference = Reference::new(means)?;
    reference.check("means", means, [None, Some(3)], "[N, 3]")?;
    reference.check("cam_from_world", &camera.cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
    check_sh(&reference, sh, means.dims()[0])?;
    reference.check_fits(&[sh_need(sh)])?;
    let inputs = ShadeInputs {
        sh: sh.clone().into_dispatch(),
        means: means.clone().into_dispatch(),
        cam_from_world: camera.cam_from_world.clone().into_dispatch(),
    };
    Ok(Tensor::from_dispatch(<Dispatch as SplatBackend>::shade(inputs)))
}

/// What each Gaussian shows a camera, `[N, C]`, whatever its colour is made of: [`shade`](fn@shade) for harmonics of one degree
/// or of two, and features as they are.
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
    let shade = |sh: &Tensor<3>, means: &Tensor<2>, camera: &Camera| shade(&up_to_degree(sh, degree), means, camera);
    match &splats.colour {
        Colour::SphericalHarmonics(sh) => shade(sh, &splats.means, camera),
        Colour::Features(features) => Ok(features.clone()),
        Colour::Mixed { directional, matte } => {
            let (means, count) = (&splats.means, splats.means.dims()[0]);
            match check_harmonics(&Reference::new(means)?, (directional, Some(matte)), count)? {
                (sh, None) => shade(sh, means, camera),
                (sh, Some(matte)) => {
                    let first = sh.dims()[0];
                    let directional = shade(sh, &means.clone().narrow(0, 0, first), camera)?;
                    let matte = shade(matte, &means.clone().narrow(0, first, count - first), camera)?;
                    Ok(Tensor::cat(vec![directional, matte], 0))
                }
            }
        }
    }
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

fn check_sh(reference: &Reference, sh: &Tensor<3>, count: usize) -> Result<(), SplatError> {
    const EXPECTED: &str = "[N, (degree+1)², 3] with degree 0 to 4";
    reference.check_or_half("sh", sh, [Some(count), None, Some(3)], EXPECTED)?;
    check_coefficients("sh", sh, EXPECTED)
}

fn check_coefficients(name: &'static str, sh: &Tensor<3>, expected: &'static str) -> Result<(), SplatError> {
    match sh_degree(sh.dims()[1]) {
        Some(_) => Ok(()),
        None => Err(SplatError::Shape {
            name,
            found: sh.dims().to_vec(),
            expected,
            hint: "give 1, 4, 9, 16 or 25 coefficients per channel".into(),
        }),
    }
}

/// Coefficients of all Gaussians, checked: of one degree, or of the first ones and of the matte ones after them, neither of
/// which are none.
pub(crate) fn check_harmonics<'a>(
    reference: &Reference,
    (sh, matte): (&'a Tensor<3>, Option<&'a Tensor<3>>),
    count: usize,
) -> Result<(&'a Tensor<3>, Option<&'a Tensor<3>>), SplatError> {
    let Some(matte) = matte else {
        check_sh(reference, sh, count)?;
        return Ok((sh, None));
    };
    const EXPECTED: &str = "[M, (degree+1)², 3] for the first M of N Gaussians, with degree 0 to 4";
    let directional = sh.dims()[0];
    reference.check_or_half("directional", sh, [Some(directional.min(count)), None, Some(3)], EXPECTED)?;
    check_coefficients("directional", sh, EXPECTED)?;
    let others = "[N − M, 1, 3] for all Gaussians that `directional` has no row of";
    reference.check_or_half("matte", matte, [Some(count - directional), Some(1), Some(3)], others)?;
    if sh.dtype() != matte.dtype() {
        let (found, expected) = (format!("{:?}", matte.dtype()), format!("{:?}, as `directional`", sh.dtype()));
        return Err(SplatError::DType { name: "matte", found, expected });
    }
    Ok(match (directional, count - directional) {
        (_, 0) => (sh, None),
        (0, _) => (matte, None),
        _ => (sh, Some(matte)),
    })
}
