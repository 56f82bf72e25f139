//! Pictures of Gaussians, blended front to back.

use burn::tensor::kind::Basic;
use burn::tensor::{Bool, Tensor};

use super::checked::Checked;
use crate::backend::apply;
use crate::rasterize::RasterizeSpec;
use crate::rasterize::operation::Rasterize;
use crate::{Extras, Intersections, Projected, RenderOptions, Result};

/// Rendered pictures: `Rendered<3>` holds the picture of one camera, `[H, W, …]`; `Rendered<4>` holds those of several cameras,
/// `[B, H, W, …]`. Pictures are differentiable.
///
/// What is optional is there if the field of its name in [`RenderOptions`] is set, and costs nothing otherwise.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Rendered<const D: usize> {
    /// `[.., H, W, C]`: colours or features over the background.
    pub colour: Tensor<D>,
    /// `[.., H, W, 1]`: alpha, `1 − T` with the transmittance `T` behind the last Gaussian.
    pub alpha: Tensor<D>,
    /// `[.., H, W, 1]`: depth `Σ wᵢ zᵢ`, scene units, not divided by alpha.
    pub depth: Option<Tensor<D>>,
    /// `[.., H, W, 1]`: depth divided by alpha, scene units: the mean depth of what a pixel shows. It is zero where nothing is. The divisor
    /// is at least 1e-10, as in gsplat.
    pub expected_depth: Option<Tensor<D>>,
    /// `[.., H, W, 3]`: [normals](fn@crate::normals) `Σ wᵢ nᵢ`, world frame, not divided by alpha, over zero. Not of
    /// [`rasterize`](fn@rasterize), which does not know the Gaussians.
    pub normals: Option<Tensor<D>>,
    /// `[B, N, 2]`, with `B = 1` for one camera: radii of the ellipses, as [`Projected::radii`]. Without gradient.
    pub radii: Option<Tensor<3>>,
    /// `[B, N]`: which Gaussians are not culled, as [`Projected::visible`].
    pub visible: Option<Tensor<2, Bool>>,
}

impl Rendered<3> {
    /// A picture with those outputs that the options ask for, of which `depth` serves two. Others are absent.
    pub(super) fn of(colour: Tensor<3>, alpha: Tensor<3>, depth: Option<Tensor<3>>, options: &RenderOptions) -> Self {
        let expected_depth = depth.clone().filter(|_| options.expected_depth);
        Self {
            depth: depth.filter(|_| options.depth),
            expected_depth: expected_depth.map(|depth| depth / alpha.clone().clamp_min(1e-10)),
            normals: None,
            radii: None,
            visible: None,
            colour,
            alpha,
        }
    }
}

impl<const D: usize> Rendered<D> {
    /// Combines pictures with the same outputs, one output after the other: their mean, for example. Radii, and what is visible, are those
    /// of all pictures in turn.
    ///
    /// # Panics
    /// If there is no picture.
    pub fn combined<const E: usize>(pictures: &[Self], combine: impl Fn(Vec<Tensor<D>>) -> Tensor<E>) -> Rendered<E> {
        let all = |of: fn(&Self) -> Option<&Tensor<D>>| {
            let planes: Option<Vec<_>> = pictures.iter().map(|picture| of(picture).cloned()).collect();
            planes.map(&combine)
        };
        Rendered {
            colour: combine(pictures.iter().map(|picture| picture.colour.clone()).collect()),
            alpha: combine(pictures.iter().map(|picture| picture.alpha.clone()).collect()),
            depth: all(|picture| picture.depth.as_ref()),
            expected_depth: all(|picture| picture.expected_depth.as_ref()),
            normals: all(|picture| picture.normals.as_ref()),
            radii: joined(pictures.iter().map(|picture| picture.radii.clone())),
            visible: joined(pictures.iter().map(|picture| picture.visible.clone())),
        }
    }
}

/// Joins an output of several pictures; that of a single one is not copied.
fn joined<const D: usize, K: Basic>(parts: impl Iterator<Item = Option<Tensor<D, K>>>) -> Option<Tensor<D, K>> {
    let mut parts: Vec<_> = parts.collect::<Option<_>>()?;
    if parts.len() > 1 { Some(Tensor::cat(parts, 0)) } else { parts.pop() }
}

/// Rasterizes features `[N, C]`: blends the Gaussians of each tile front to back over `extras.background`.
///
/// Returns a picture `[H, W, C]`, its alpha and, if asked for, other outputs. Differentiable in the ellipses, the features and the
/// background. `intersections` must come from `projected` with the same options; a smaller `alpha_min` serves too. Of `extras`, only `background` and
/// `mean2d_abs_probe` are read. Equations and sources: [`crate::rasterize`](mod@crate::rasterize).
///
/// # Errors
/// If a tensor's shape, type or device does not fit, if an option is out of range, if `projected` was not made with
/// `options.projection`, or if `intersections` are of other Gaussians, another camera or other options.
pub fn rasterize(
    projected: &Projected,
    features: &Tensor<2>,
    intersections: &Intersections,
    extras: &Extras,
    options: &RenderOptions,
) -> Result<Rendered<3>> {
    let checked = projected.checked(options)?;
    checked.features(features)?;
    let channels = features.dims()[1];
    checked.picture(projected.intrinsics(), channels)?;
    let background = checked.background(extras.background.clone(), channels)?;
    let mean2d_abs_probe = checked.probe("mean2d_abs_probe", extras.mean2d_abs_probe.as_ref())?;
    intersections.check(&checked, projected.intrinsics())?;
    let blend = Blend { features: features.clone(), background, mean2d_abs_probe };
    Ok(blended(&checked, projected, intersections, blend))
}

/// What is blended besides ellipses, checked.
pub(crate) struct Blend {
    pub features: Tensor<2>,
    pub background: Tensor<1>,
    pub mean2d_abs_probe: Tensor<2>,
}

/// [`rasterize`](fn@rasterize) of inputs that have been checked.
pub(crate) fn blended(checked: &Checked, projected: &Projected, lists: &Intersections, blend: Blend) -> Rendered<3> {
    let options = checked.options;
    let spec = RasterizeSpec { intrinsics: projected.intrinsics, options: options.of_rasterize() };
    let Blend { features, background, mean2d_abs_probe } = blend;
    let inputs = [
        (&projected.packed).into(),
        features.into(),
        background.into(),
        mean2d_abs_probe.into(),
        projected.ray_space.as_ref().into(),
        (&lists.counts).into(),
    ];
    let mut planes = apply(Rasterize { spec, lists: lists.lists.clone(), trace: None }, inputs);
    let mut picture = |i: usize| planes.float::<3>(i).permute([1, 2, 0]);
    let (colour, alpha) = (picture(0), picture(1));
    let depth = spec.options.depth.then(|| picture(2));
    let mut rendered = Rendered::of(colour, alpha, depth, options);
    rendered.radii = options.radii.then(|| projected.radii().unsqueeze_dim(0));
    rendered.visible = options.visible.then(|| projected.visible().unsqueeze_dim(0));
    rendered
}
