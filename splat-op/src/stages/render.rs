//! Renders pictures: all stages in one call.

use std::slice;

use burn::tensor::{Int, Tensor};

use super::checked::Checked;
use super::colour::seen;
use super::covariances::factored;
use super::intersections::listed;
use super::normals::facing;
use super::projected::projected;
use super::rendered::{Blend, Rendered, blended};
use super::tile_mask::checked_mask;
use crate::abilities::check_fits;
use crate::backend::custom_grad::constant;
use crate::check::check_value;
use crate::limits::Need;
use crate::{Camera, Extras, RenderOptions, Result, Splats};

/// Renders Gaussians as seen by one or several cameras with pictures of one size.
///
/// Returns `B` pictures, `[B, H, W, C]`, for `B` cameras. For each camera it runs [`project`](fn@crate::project), [`visible_colours`](crate::visible_colours),
/// [`intersect`](fn@crate::intersect) and [`rasterize`](fn@crate::rasterize). Differentiable in all tensors of `splats`, in the poses and in the
/// background; gradients of shared inputs are summed over the cameras.
///
/// # Errors
/// If there is no camera, if the sizes of their pictures differ, if a tensor's shape, type or device does not fit, if a camera or
/// option is out of range, or if a buffer would be larger than the device allows.
pub fn render(splats: &Splats, cameras: &[Camera], extras: &Extras, options: &RenderOptions) -> Result<Rendered<4>> {
    check_value("cameras", !cameras.is_empty(), 0, "at least one camera")?;
    let size = |camera: &Camera| (camera.intrinsics.width, camera.intrinsics.height);
    let (width, height) = size(&cameras[0]);
    for other in cameras.iter().map(size) {
        let found = format_args!("pictures of {:?} and {other:?} px", (width, height));
        let expected = "cameras of one size: `render_each` takes others";
        check_value("cameras", other == (width, height), found, expected)?;
    }
    let all = [cameras.len(), splats.colour.channels(), height, width];
    let need = Need::floats("the pictures of all cameras", all, "render fewer cameras in one call");
    check_fits(&splats.means.device(), &[need])?;
    let pictures = render_each(splats, cameras, extras, options)?;
    // A single picture is viewed, not copied.
    Ok(Rendered::combined(&pictures, |mut planes| match planes.len() {
        1 => planes.remove(0).unsqueeze_dim(0),
        _ => Tensor::stack(planes, 0),
    }))
}

/// Renders Gaussians as seen by cameras whose pictures may differ in size. Returns a picture for each camera, `[H, W, C]`; see [`render`].
///
/// # Errors
/// As [`render`]; pictures may differ in size, and there may be no camera.
pub fn render_each(
    splats: &Splats,
    cameras: &[Camera],
    extras: &Extras,
    options: &RenderOptions,
) -> Result<Vec<Rendered<3>>> {
    let channels = splats.colour.channels();
    let checked = Checked::gaussians(splats, options)?;
    checked.colour(&splats.colour)?;
    let (shapes, factors) = factored(&checked, splats, extras)?;
    let mean2d_probe = checked.probe("mean2d_probe", extras.mean2d_probe.as_ref())?;
    let mean2d_abs_probe = checked.probe("mean2d_abs_probe", extras.mean2d_abs_probe.as_ref())?;
    let backgrounds = match &extras.backgrounds {
        Some(rows) => {
            checked.reference().check(
                "backgrounds",
                rows,
                [Some(cameras.len()), Some(channels)],
                "[B, C] for B cameras",
            )?;
            (0..cameras.len()).map(|i| rows.clone().narrow(0, i, 1).squeeze_dim(0)).collect()
        }
        None => vec![checked.background(extras.background.clone(), channels)?; cameras.len()],
    };
    let mut masks = Vec::with_capacity(cameras.len());
    for camera in cameras {
        checked.camera(camera)?;
        checked.lists(&camera.intrinsics)?;
        checked.picture(&camera.intrinsics, channels + if options.normals { 3 } else { 0 })?;
        let mask = extras.tile_mask.as_ref().map(|mask| checked_mask(&checked, &camera.intrinsics, mask));
        masks.push(mask.transpose()?);
    }
    let one = |((camera, mask), mut background): ((&Camera, Option<Tensor<2, Int>>), Tensor<1>)| {
        let projected = projected(&checked, &shapes, factors, camera, mean2d_probe.clone());
        let mut features = seen(&splats.colour, &splats.means, camera, Some(&projected), options);
        if options.normals {
            features = with_three(features, facing(splats, camera));
            background = with_three(background, Tensor::zeros([3], checked.reference().options()));
        }
        let blend = Blend { features, background, mean2d_abs_probe: mean2d_abs_probe.clone() };
        let mut picture = blended(&checked, &projected, &listed(&checked, &projected, mask), blend);
        if options.normals {
            picture.normals = Some(picture.colour.clone().narrow(2, channels, 3));
            picture.colour = picture.colour.narrow(2, 0, channels);
        }
        picture
    };
    Ok(cameras.iter().zip(masks).zip(backgrounds).map(one).collect())
}

/// Renders Gaussians as seen by one camera.
///
/// Returns one picture, `[H, W, C]`. It computes what [`render`] computes, without the dimension of the cameras; some backends
/// copy the picture to remove that dimension again.
///
/// # Errors
/// As [`render`].
pub fn render_view(splats: &Splats, camera: &Camera, extras: &Extras, options: &RenderOptions) -> Result<Rendered<3>> {
    let expected = "`background`: one camera has one, and `render_each` takes several";
    check_value("backgrounds", extras.backgrounds.is_none(), "given", expected)?;
    Ok(render_each(splats, slice::from_ref(camera), extras, options)?.remove(0))
}

/// Appends three channels to a tensor whose last dimension is that of channels. One of both may be a constant.
fn with_three<const D: usize>(of: Tensor<D>, three: Tensor<D>) -> Tensor<D> {
    let tracked = of.is_autodiff() || three.is_autodiff();
    Tensor::cat(vec![constant(&of, tracked), constant(&three, tracked)], D - 1)
}
