//! What Gaussians look like: features, or spherical harmonics of one degree or of two.

use burn::backend::Dispatch;
use burn::tensor::Tensor;

use crate::camera::Camera;
use crate::check::Reference;
use crate::error::SplatError;
use crate::limits::Need;
use crate::op::SplatBackend;
use crate::shade::{ShadeInputs, sh_degree};
use crate::stages::Splats;

/// What each Gaussian looks like.
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
    Need::floats("sh", sh.dims(), "use fewer Gaussians or a lower degree of the spherical harmonics")
}

fn check_sh(reference: &Reference, sh: &Tensor<3>, count: usize) -> Result<(), SplatError> {
    const EXPECTED: &str = "[N, (degree+1)², 3] with degree 0 to 4";
    reference.check("sh", sh, [Some(count), None, Some(3)], EXPECTED)?;
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
    reference.check("directional", sh, [Some(directional.min(count)), None, Some(3)], EXPECTED)?;
    check_coefficients("directional", sh, EXPECTED)?;
    let others = "[N − M, 1, 3] for all Gaussians that `directional` has no row of";
    reference.check("matte", matte, [Some(count - directional), Some(1), Some(3)], others)?;
    Ok(match (directional, count - directional) {
        (_, 0) => (sh, None),
        (0, _) => (matte, None),
        _ => (sh, Some(matte)),
    })
}
