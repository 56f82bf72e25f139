//! Inputs of a render besides cameras and options: Gaussians, their colours, and optional inputs.

use burn::tensor::{Bool, Tensor};

/// Gaussians with activated parameters, one row each, all of one float type (f32; f64 on CPU devices) and on one device.
#[derive(Clone, Debug)]
pub struct Splats {
    /// `[N, 3]`: centres, world frame, scene units.
    pub means: Tensor<2>,
    /// `[N, 4]`: quaternions wxyz, world-from-Gaussian, of any non-zero length.
    pub rotations: Tensor<2>,
    /// `[N, 3]`: standard deviations along the rotated axes, scene units.
    pub scales: Tensor<2>,
    /// `[N]`: opacities, 0 to 1. A Gaussian with an opacity of exactly 0 is not drawn and has no gradient.
    pub opacities: Tensor<1>,
    /// Colours or features.
    pub colour: Colour,
}

/// Optional inputs of a render. Start from none, [`Extras::default`], and add some with the builders `with_…`, which take a tensor or an
/// `Option` of one.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Extras {
    /// `[C]`: background colour or features, seen through the Gaussians; zero if absent.
    pub background: Option<Tensor<1>>,
    /// `[B, C]`: a background for each of the cameras of [`render`](fn@crate::render), instead of `background`.
    pub backgrounds: Option<Tensor<2>>,
    /// `[N, 3, 3]`: covariances, world frame, scene units squared, instead of the rotations and scales of the Gaussians, whose values are then
    /// not read. The lower triangles are read. A Gaussian whose covariance is not positive definite in its float type, such as one that is flat
    /// or a point, is culled; a small multiple of the identity makes it visible. In f32 axes may differ in length by a factor of a few
    /// hundred. With [`Projection::Affine`](crate::Projection) only.
    pub covariances: Option<Tensor<3>>,
    /// `[N, 2]`: tracked leaf tensor whose gradient becomes `∂L/∂mean2d` at the projected centres, per px, summed over the
    /// cameras. (Burn keeps no gradients of intermediate tensors.) Its values are not read. The field's densification threshold,
    /// 2e-4, is per unit of normalised device coordinates: multiply the gradient by `[width / 2, height / 2]` before comparing.
    /// With [`Projection::RayMax`](crate::Projection) it is the gradient of a step of the Gaussian across the camera's axis, a pixel wide at its
    /// centre's depth.
    pub mean2d_probe: Option<Tensor<2>>,
    /// `[N, 2]`: as `mean2d_probe`, with the absolute value of each pixel's contribution (AbsGrad, Ye et al. 2024).
    pub mean2d_abs_probe: Option<Tensor<2>>,
    /// `[tiles along y, tiles along x]`: the tiles of 16 × 16 px to render, all if absent. The others show the background alone, with an
    /// alpha of zero, and are not rasterized. All cameras of a call share it. Between the stages it is
    /// [`intersect_masked`](crate::intersect_masked) that takes it.
    pub tile_mask: Option<Tensor<2, Bool>>,
}

/// Declares the builders of [`Extras`], each of which sets one field.
macro_rules! builders {
    ($($builder:ident($field:ident: $type:ty);)*) => {
        impl Extras {$(
            #[doc = concat!("Sets [`", stringify!($field), "`](Self::", stringify!($field), ").")]
            pub fn $builder(self, $field: impl Into<Option<$type>>) -> Self {
                Self { $field: $field.into(), ..self }
            }
        )*}
    };
}

builders! {
    with_background(background: Tensor<1>);
    with_backgrounds(backgrounds: Tensor<2>);
    with_covariances(covariances: Tensor<3>);
    with_mean2d_probe(mean2d_probe: Tensor<2>);
    with_mean2d_abs_probe(mean2d_abs_probe: Tensor<2>);
    with_tile_mask(tile_mask: Tensor<2, Bool>);
}

/// Colours or features of Gaussians.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Colour {
    /// Spherical-harmonics coefficients `[N, (degree+1)², 3]`, degree 0 to 4.
    SphericalHarmonics(Tensor<3>),
    /// The same in several tensors, each with the coefficients `[n, (degree+1)², 3]` of the next `n` Gaussians: for scenes with
    /// more coefficients than a GPU's [largest buffer](crate::largest_tensor) holds.
    SphericalHarmonicsBlocks(Vec<Tensor<3>>),
    /// Features `[N, C]` of any number of channels, rasterized unchanged.
    Features(Tensor<2>),
}

impl Colour {
    /// The number of channels.
    pub(crate) fn channels(&self) -> usize {
        if let Self::Features(features) = self { features.dims()[1] } else { 3 }
    }
}
