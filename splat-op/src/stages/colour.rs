//! Colours of Gaussians as a camera sees them.

use burn::tensor::Tensor;

use super::checked::Checked;
use crate::backend::apply;
use crate::project::{COLUMNS, ProjectSpec};
use crate::sh::operation::EvaluateSh;
use crate::{Camera, CameraModel, Colour, Projected, RenderOptions, Result, Splats};

/// Evaluates spherical harmonics for the directions from a camera to Gaussians; those of an orthographic camera are its axis.
///
/// Takes coefficients `[N, (degree+1)², 3]`, degree 0 to 4, and centres `means` `[N, 3]`, world frame, scene units. Returns colours
/// `[N, 3]`, at least 0. Differentiable in the coefficients, the centres and the pose. Equations and sources: [`crate::sh`].
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn evaluate_sh(sh: &Tensor<3>, means: &Tensor<2>, camera: &Camera) -> Result<Tensor<2>> {
    let (colour, options) = (Colour::SphericalHarmonics(sh.clone()), RenderOptions::standard());
    check(&colour, means, camera, &options)?;
    Ok(seen(&colour, means, camera, None, &options))
}

/// Centres and a pose in place of an orthographic camera's, for which all directions are those of its rays: the last row of the pose's
/// matrix.
fn along_axis(pose: &Tensor<2>, count: usize) -> (Tensor<2>, Tensor<2>) {
    let axis = pose.clone().narrow(0, 2, 1).narrow(1, 0, 3).expand([count, 3]);
    let identity = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    (axis, Tensor::<2>::from_floats(identity, &pose.device()).cast(pose.dtype()))
}

/// Returns the colour or features `[N, C]` of each Gaussian as a camera sees it.
///
/// Spherical harmonics go through [`evaluate_sh`](fn@evaluate_sh); features are returned unchanged.
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn colours(splats: &Splats, camera: &Camera) -> Result<Tensor<2>> {
    colours_up_to(splats, camera, None)
}

/// Returns the colour or features `[N, C]` of each Gaussian as [`colours`] does, without harmonics above `degree`. `None` uses all degrees.
///
/// # Errors
/// As [`colours`].
pub fn colours_up_to(splats: &Splats, camera: &Camera, degree: Option<usize>) -> Result<Tensor<2>> {
    let options = RenderOptions::standard();
    check(&splats.colour, &splats.means, camera, &options)?;
    Ok(seen(&splats.colour, &splats.means, camera, None, &options.with_sh_degree(degree)))
}

/// Returns the colour or features `[N, C]` of each Gaussian for one picture.
///
/// The values are those of [`colours`] without harmonics above `options.sh_degree`. A Gaussian whose ellipse in `projected` cannot
/// show in the picture gets a colour of zero, and its harmonics are not read; [`crate::sh`] defines which Gaussians these are.
/// The zeros are constants: no gradient flows through them. Per-ray rasterization needs the colours of all Gaussians, so none is
/// skipped for it. Features are returned unchanged.
///
/// # Errors
/// As [`colours`]; if `projected` has another number of Gaussians, or if an option is out of range.
pub fn visible_colours(
    splats: &Splats,
    camera: &Camera,
    projected: &Projected,
    options: &RenderOptions,
) -> Result<Tensor<2>> {
    let checked = check(&splats.colour, &splats.means, camera, options)?;
    checked.reference().check("projected", &projected.packed, [Some(checked.count), Some(COLUMNS)], "[N, 7]")?;
    Ok(seen(&splats.colour, &splats.means, camera, Some(projected), options))
}

fn check<'a>(colour: &Colour, means: &Tensor<2>, camera: &Camera, options: &'a RenderOptions) -> Result<Checked<'a>> {
    let checked = Checked::new("means", means, options)?;
    checked.reference().check("means", means, [None, Some(3)], "[N, 3]")?;
    checked.pose(camera)?;
    checked.colour(colour)?;
    Ok(checked)
}

/// Returns colours whose inputs have been checked, without harmonics above `options.sh_degree`. If the ellipses of a picture are given,
/// Gaussians that cannot show in it have a colour of zero.
pub(super) fn seen(
    colour: &Colour,
    means: &Tensor<2>,
    camera: &Camera,
    projected: Option<&Projected>,
    options: &RenderOptions,
) -> Tensor<2> {
    // A ray may hit a Gaussian whose ellipse lies outside the picture.
    let visible = projected.filter(|_| !options.along_rays());
    let intrinsics = visible.map_or(camera.intrinsics, |visible| *visible.intrinsics());
    let spec = ProjectSpec { intrinsics, options: *options, factors: false };
    let evaluate = |sh: &Tensor<3>, means: Tensor<2>, ellipses: Option<Tensor<2>>| {
        let coefficients = options.sh_degree.map_or(usize::MAX, |degree| (degree + 1) * (degree + 1));
        let sh = if coefficients < sh.dims()[1] { sh.clone().narrow(1, 0, coefficients) } else { sh.clone() };
        let (means, pose) = match camera.intrinsics.model {
            CameraModel::Orthographic if means.dims()[0] > 0 => along_axis(&camera.cam_from_world, means.dims()[0]),
            _ => (means, camera.cam_from_world.clone()),
        };
        let inputs = [sh.into(), means.into(), pose.into(), ellipses.into()];
        apply(EvaluateSh(spec), inputs).float(0)
    };
    let ellipses = visible.map(|visible| &visible.packed);
    let blocks = match colour {
        Colour::Features(features) => return features.clone(),
        Colour::SphericalHarmonics(sh) => return evaluate(sh, means.clone(), ellipses.cloned()),
        Colour::SphericalHarmonicsBlocks(blocks) => blocks,
    };
    let mut first = 0;
    // Burn narrows no tensor to no rows.
    let colours = blocks.iter().filter(|sh| sh.dims()[0] > 0).map(|sh| {
        let of_block = |all: &Tensor<2>| all.clone().narrow(0, first, sh.dims()[0]);
        let colours = evaluate(sh, of_block(means), ellipses.map(of_block));
        first += sh.dims()[0];
        colours
    });
    let colours: Vec<Tensor<2>> = colours.collect();
    if colours.is_empty() { Tensor::empty([0, 3], (&means.device(), means.dtype())) } else { Tensor::cat(colours, 0) }
}
