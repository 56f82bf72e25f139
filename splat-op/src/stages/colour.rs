//! Colours of Gaussians as a camera sees them.

use burn::tensor::Tensor;

use super::splats::{Colour, Splats, sh_need, up_to_degree};
use crate::backend::apply;
use crate::camera::{Camera, CameraModel, Intrinsics};
use crate::check::Reference;
use crate::error::SplatError;
use crate::options::RenderOptions;
use crate::project::{COLUMNS, ProjectSpec};
use crate::sh::operation::EvaluateSh;
use crate::sh::sh_degree;
use crate::stages::Projected;

/// Evaluates spherical harmonics for the directions from a camera to Gaussians; those of an orthographic camera are its axis.
///
/// Takes coefficients `[N, (degree+1)², 3]`, degree 0 to 4, and centres `means` `[N, 3]`, world frame, scene units. Returns colours
/// `[N, 3]`, at least 0. Differentiable in the coefficients, the centres and the pose. Equations and sources: [`crate::sh`].
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn evaluate_sh(sh: &Tensor<3>, means: &Tensor<2>, camera: &Camera) -> Result<Tensor<2>, SplatError> {
    // The options are read only to decide visibility, which needs ellipses.
    sh_visible(sh, means, camera, None, &RenderOptions::standard())
}

/// Evaluates spherical harmonics up to a degree, given in blocks of consecutive Gaussians, block by block as [`sh_visible`].
fn blocks_visible(
    blocks: &[Tensor<3>],
    degree: Option<usize>,
    means: &Tensor<2>,
    camera: &Camera,
    visible: Option<&Projected>,
    options: &RenderOptions,
) -> Result<Tensor<2>, SplatError> {
    let visible = visible.map(|visible| (visible.packed().clone(), *visible.intrinsics()));
    if let [sh] = blocks {
        return sh_visible(&up_to_degree(sh, degree), means, camera, visible, options);
    }
    let counts: Vec<usize> = blocks.iter().map(|sh| sh.dims()[0]).collect();
    let count = means.dims()[0];
    if blocks.is_empty() || counts.iter().sum::<usize>() != count {
        let (expected, hint) = ("blocks with N rows together", format!("there are {count} Gaussians"));
        return Err(SplatError::Shape { name: "sh", found: counts, expected, hint });
    }
    if let Some((packed, _)) = &visible {
        Reference::new("means", means)?.check("projected", packed, [Some(count), Some(COLUMNS)], "[N, 7]")?;
    }
    let mut first = 0;
    // Burn narrows no tensor to no rows.
    let colours = blocks.iter().zip(counts).filter(|(_, rows)| *rows > 0).map(|(sh, rows)| {
        let of_block = |all: Tensor<2>| all.narrow(0, first, rows);
        let visible = visible.clone().map(|(packed, intrinsics)| (of_block(packed), intrinsics));
        let colours = sh_visible(&up_to_degree(sh, degree), &of_block(means.clone()), camera, visible, options);
        first += rows;
        colours
    });
    let colours: Vec<_> = colours.collect::<Result<_, _>>()?;
    match colours.is_empty() {
        true => Ok(Tensor::zeros([0, 3], (&means.device(), means.dtype()))),
        false => Ok(Tensor::cat(colours, 0)),
    }
}

/// Evaluates spherical harmonics as [`evaluate_sh`]. If `visible` is given, packed ellipses of a picture, only Gaussians that
/// can show in it get a colour; the colours of all others are zero.
fn sh_visible(
    sh: &Tensor<3>,
    means: &Tensor<2>,
    camera: &Camera,
    visible: Option<(Tensor<2>, Intrinsics)>,
    options: &RenderOptions,
) -> Result<Tensor<2>, SplatError> {
    let reference = Reference::new("means", means)?;
    let count = means.dims()[0];
    reference.check("means", means, [None, Some(3)], "[N, 3]")?;
    reference.check("cam_from_world", &camera.cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
    check_sh(&reference, sh, count)?;
    reference.check_fits(&[sh_need(sh)])?;
    if let Some((visible, _)) = &visible {
        reference.check("projected", visible, [Some(count), Some(COLUMNS)], "[N, 7]")?;
    }
    let intrinsics = visible.as_ref().map_or(camera.intrinsics, |(_, intrinsics)| *intrinsics);
    let visible = visible.map(|(visible, _)| visible);
    let spec = ProjectSpec { intrinsics, options: *options, factors: false };
    let (means, pose) = match camera.intrinsics.model {
        CameraModel::Orthographic if count > 0 => along_axis(&camera.cam_from_world, count),
        _ => (means.clone(), camera.cam_from_world.clone()),
    };
    let inputs = [sh.into(), (&means).into(), (&pose).into(), visible.into()];
    Ok(apply(EvaluateSh(spec), inputs).float(0))
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
pub fn colours(splats: &Splats, camera: &Camera) -> Result<Tensor<2>, SplatError> {
    colours_up_to(splats, camera, None)
}

/// Returns the colour or features `[N, C]` of each Gaussian as [`colours`] does, without harmonics above `degree`. `None` uses
/// all degrees.
///
/// # Errors
/// As [`colours`].
pub fn colours_up_to(splats: &Splats, camera: &Camera, degree: Option<usize>) -> Result<Tensor<2>, SplatError> {
    match &splats.colour {
        Colour::Features(features) => Ok(features.clone()),
        harmonics => {
            let options = RenderOptions::standard();
            blocks_visible(harmonics.blocks(), degree, &splats.means, camera, None, &options)
        }
    }
}

/// Returns the colour or features `[N, C]` of each Gaussian for one picture.
///
/// The values are those of [`colours`] without harmonics above `options.sh_degree`. A Gaussian whose ellipse in `projected` cannot
/// show in the picture gets a colour of zero, and its harmonics are not read; [`crate::sh`] defines which Gaussians these are.
/// The zeros are constants: no gradient flows through them. Per-ray rasterization needs the colours of all Gaussians, so none is
/// skipped for it. Features are returned unchanged.
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
        Colour::Features(features) => Ok(features.clone()),
        harmonics => {
            // A ray may hit a Gaussian whose ellipse lies outside the picture.
            let visible = (!options.along_rays()).then_some(projected);
            blocks_visible(harmonics.blocks(), options.sh_degree, &splats.means, camera, visible, options)
        }
    }
}

fn check_sh(reference: &Reference, sh: &Tensor<3>, count: usize) -> Result<(), SplatError> {
    const EXPECTED: &str = "[N, (degree+1)², 3] with degree 0 to 4";
    reference.check("sh", sh, [Some(count), None, Some(3)], EXPECTED)?;
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
