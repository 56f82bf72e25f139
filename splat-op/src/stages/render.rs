//! Renders pictures: all stages in one call.

use burn::tensor::Tensor;

use super::colour::visible_colours;
use super::splats::{Colour, Extras, Splats};
use crate::camera::Camera;
use crate::check::{Reference, check_positive};
use crate::error::SplatError;
use crate::options::RenderOptions;
use crate::stages::tile_mask::intersect_masked;
use crate::stages::{Rendered, check_render_fits, intersect, project, rasterize};

/// Renders Gaussians as seen by one or several cameras with pictures of one size.
///
/// Returns `B` pictures, `[B, H, W, C]`, for `B` cameras. For each camera it runs [`project`](fn@project), [`visible_colours`],
/// [`intersect`](fn@intersect) and [`rasterize`](fn@rasterize). Differentiable in all tensors of `splats`, in the poses and in the
/// background; gradients of shared inputs are summed over the cameras.
///
/// # Errors
/// If there is no camera, if the sizes of their pictures differ, if a tensor's shape, type or device does not fit, if a camera or
/// option is out of range, or if a buffer would be larger than the device allows.
pub fn render(
    splats: &Splats,
    cameras: &[Camera],
    extras: &Extras,
    options: &RenderOptions,
) -> Result<Rendered<4>, SplatError> {
    check_positive("cameras", cameras.len(), "at least one camera")?;
    let size = |camera: &Camera| (camera.intrinsics.width, camera.intrinsics.height);
    if let Some(other) = cameras.iter().find(|camera| size(camera) != size(&cameras[0])) {
        return Err(SplatError::Value {
            field: "cameras",
            found: format!("pictures of {:?} and {:?} px", size(&cameras[0]), size(other)),
            expected: "cameras of one size: `render_each` takes others",
        });
    }
    check_render_fits(splats, cameras.len(), &cameras[0].intrinsics, options)?;
    let pictures = render_each(splats, cameras, extras, options)?;
    Ok(Rendered {
        colour: stack(pictures.iter().map(|picture| picture.colour.clone())),
        alpha: stack(pictures.iter().map(|picture| picture.alpha.clone())),
        depth: options.depth.then(|| stack(pictures.iter().filter_map(|picture| picture.depth.clone()))),
    })
}

/// Renders Gaussians as seen by cameras whose pictures may differ in size. Returns a picture for each camera, `[H, W, C]`; see
/// [`render`].
///
/// # Errors
/// As [`render`]; pictures may differ in size, and there may be no camera.
pub fn render_each(
    splats: &Splats,
    cameras: &[Camera],
    extras: &Extras,
    options: &RenderOptions,
) -> Result<Vec<Rendered<3>>, SplatError> {
    if let Some(backgrounds) = &extras.backgrounds {
        let channels = if let Colour::Features(features) = &splats.colour { features.dims()[1] } else { 3 };
        let shape = [Some(cameras.len()), Some(channels)];
        Reference::new("means", &splats.means)?.check("backgrounds", backgrounds, shape, "[B, C] for B cameras")?;
    }
    let one = |(i, camera): (usize, &Camera)| {
        let own = extras.backgrounds.as_ref().map(|rows| rows.clone().narrow(0, i, 1).squeeze_dim(0));
        let extras = Extras { background: own.or(extras.background.clone()), backgrounds: None, ..extras.clone() };
        render_view(splats, camera, &extras, options)
    };
    cameras.iter().enumerate().map(one).collect()
}

/// Renders Gaussians as seen by one camera.
///
/// Returns one picture, `[H, W, C]`. It computes what [`render`] computes, without the dimension of the cameras; some backends
/// copy the picture to remove that dimension again.
///
/// # Errors
/// As [`render`].
pub fn render_view(
    splats: &Splats,
    camera: &Camera,
    extras: &Extras,
    options: &RenderOptions,
) -> Result<Rendered<3>, SplatError> {
    if extras.backgrounds.is_some() {
        let (found, expected) = ("given".into(), "`background`: one camera has one, and `render_each` takes several");
        return Err(SplatError::Value { field: "backgrounds", found, expected });
    }
    check_render_fits(splats, 1, &camera.intrinsics, options)?;
    let projected = project(splats, camera, extras, options)?;
    let features = visible_colours(splats, camera, &projected, options)?;
    let tiles = match &extras.tile_mask {
        Some(tile_mask) => intersect_masked(&projected, tile_mask, options)?,
        None => intersect(&projected, options)?,
    };
    rasterize(&projected, &features, &tiles, extras, options)
}

/// Stacks pictures `[H, W, C]` to `[B, H, W, C]`; a single picture is viewed, not copied.
fn stack(pictures: impl Iterator<Item = Tensor<3>>) -> Tensor<4> {
    let mut all: Vec<Tensor<4>> = pictures.map(|picture| picture.unsqueeze_dim(0)).collect();
    match all.len() {
        1 => all.remove(0),
        _ => Tensor::cat(all, 0),
    }
}
