//! The projected Gaussians of a view, as named tensors.

use burn::tensor::{Bool, Tensor};

use super::checked::{Checked, packed_need};
use super::covariances::factored;
use crate::backend::apply;
use crate::check::Reference;
use crate::project::operation::Project;
use crate::project::{COLUMNS, Geometry, ProjectSpec, RADIUS_SIGMAS};
use crate::ray_space::operation::RaySpace;
use crate::{Camera, Extras, Intrinsics, RenderOptions, Result, SplatError, Splats};

/// The screen-space ellipses of a view, one tensor per field.
///
/// `sigma_u`, `shear` and `sigma_v` are the triangular factor of the 2D covariance; [`crate::project`](mod@crate::project) derives
/// it. To change ellipses, get them from [`Projected::ellipses`], compute, and pack them again with [`Ellipses::pack`].
#[derive(Clone, Debug)]
pub struct Ellipses {
    /// `[N, 2]`: projected centres, px.
    pub mean2d: Tensor<2>,
    /// `[N]`: standard deviation along x, px.
    pub sigma_u: Tensor<1>,
    /// `[N]`: covariance of x and y divided by the variance of x, px per px.
    pub shear: Tensor<1>,
    /// `[N]`: standard deviation along y at fixed x, px.
    pub sigma_v: Tensor<1>,
    /// `[N]`: camera z of the centres, scene units; zero for culled Gaussians.
    pub depth: Tensor<1>,
    /// `[N]`: opacities, compensated if the render is anti-aliased; zero for culled Gaussians.
    pub opacity: Tensor<1>,
}

/// The projected Gaussians of one camera, as [`project`](fn@crate::project) returns them.
#[derive(Clone, Debug)]
pub struct Projected {
    /// `[N, 7]`: the ellipses, see `project/`.
    pub(super) packed: Tensor<2>,
    /// `[N, 9 (+ 6)]`: the Gaussians in ray space, see `ray_space/`; present for per-ray rasterization only.
    pub(super) ray_space: Option<Tensor<2>>,
    pub(super) intrinsics: Intrinsics,
}

impl Projected {
    /// Takes packed ellipses without rows in ray space.
    pub(crate) fn of(packed: Tensor<2>, intrinsics: Intrinsics) -> Self {
        Self { packed, ray_space: None, intrinsics }
    }

    /// Returns the packed ellipses, `[N, 7]`.
    pub(crate) fn packed(&self) -> &Tensor<2> {
        &self.packed
    }

    /// Checks options, and that the ellipses were made with their projection.
    pub(super) fn checked<'a>(&self, options: &'a RenderOptions) -> Result<Checked<'a>> {
        let expected = match (options.along_rays(), self.ray_space.is_some()) {
            (true, false) => "Affine for ellipses that were packed from fields, or projected with these options",
            (false, true) => "the projection that the ellipses were projected with",
            _ => return Checked::new("projected", &self.packed, options),
        };
        Err(SplatError::Value { field: "projection", found: format!("{:?}", options.projection), expected })
    }

    /// Returns the intrinsics of the camera that the Gaussians were projected for.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Returns the ellipses as named tensors. Differentiable.
    pub fn ellipses(&self) -> Ellipses {
        let column = |i: usize| self.packed.clone().slice([0..self.len(), i..i + 1]).squeeze_dim(1);
        Ellipses {
            mean2d: self.packed.clone().slice([0..self.len(), 0..2]),
            sigma_u: column(2),
            shear: column(3),
            sigma_v: column(4),
            depth: column(5),
            opacity: column(6),
        }
    }

    /// Returns the radii of the ellipses, three standard deviations along x and y, `[N, 2]`, px; zero for culled Gaussians. Without
    /// gradient.
    pub fn radii(&self) -> Tensor<2> {
        let Ellipses { sigma_u, shear, sigma_v, .. } = self.clone().detached().ellipses();
        let vertical = ((shear * sigma_u.clone()).square() + sigma_v.square()).sqrt();
        let radii: Tensor<2> = Tensor::stack(vec![sigma_u, vertical], 1);
        let culled: Tensor<2, Bool> = self.visible().bool_not().unsqueeze_dim(1);
        radii.mul_scalar(RADIUS_SIGMAS).mask_fill(culled.expand([self.len(), 2]), 0.0)
    }

    /// Returns which Gaussians are not culled, `[N]`: those with an opacity above zero.
    pub fn visible(&self) -> Tensor<1, Bool> {
        self.clone().detached().ellipses().opacity.greater_elem(0.0)
    }

    fn detached(self) -> Self {
        Self { packed: self.packed.detach(), ..self }
    }

    /// Returns the number of Gaussians, including culled ones.
    pub fn len(&self) -> usize {
        self.packed.dims()[0]
    }

    /// Returns whether there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Ellipses {
    /// Packs the fields for [`intersect`](fn@crate::intersect) and [`rasterize`](fn@crate::rasterize), for a camera with `intrinsics`.
    ///
    /// The fields do not contain the Gaussians in ray space. Packed ellipses can therefore only be rendered with
    /// [`Projection::Affine`](crate::Projection).
    ///
    /// # Errors
    /// If a field differs from `mean2d` in its number of rows, type or device, or if `intrinsics` are out of range.
    pub fn pack(self, intrinsics: &Intrinsics) -> Result<Projected> {
        intrinsics.check()?;
        let count = self.mean2d.dims()[0];
        let reference = Reference::new("mean2d", &self.mean2d)?;
        reference.check("mean2d", &self.mean2d, [Some(count), Some(2)], "[N, 2]")?;
        reference.check_fits(&[packed_need(count)])?;
        let mut columns = vec![self.mean2d];
        for (name, column) in [
            ("sigma_u", self.sigma_u),
            ("shear", self.shear),
            ("sigma_v", self.sigma_v),
            ("depth", self.depth),
            ("opacity", self.opacity),
        ] {
            reference.check(name, &column, [Some(count)], "[N]")?;
            columns.push(column.unsqueeze_dim(1));
        }
        Ok(Projected::of(Tensor::cat(columns, 1), *intrinsics))
    }
}

/// Projects Gaussians onto a camera's picture: EWA splatting (Zwicker et al. 2001), as in Kerbl et al. 2023, section 4.
///
/// Returns `N` ellipses, in px. Differentiable in the means, rotations, scales or covariances, opacities and the pose. Of `extras`, only
/// `covariances` and `mean2d_probe` are read.
///
/// A Gaussian is culled if one of its values is not finite, if its quaternion is zero, if the camera z of its centre is at most
/// `options.near` or at least `options.far`, if it reaches at most `options.radius_clip`, or if its centre lies outside the domain of the
/// camera's lens ([`Intrinsics::max_radius`]). The opacity, the depth and the gradients of a culled Gaussian are zero. Both planes are depths
/// for every camera model, so a fisheye sees nothing at 90° or more from its axis.
///
/// # Errors
/// If a tensor's shape, type or device does not fit, or if the camera or an option is out of range.
pub fn project(splats: &Splats, camera: &Camera, extras: &Extras, options: &RenderOptions) -> Result<Projected> {
    let checked = Checked::gaussians(splats, options)?;
    checked.camera(camera)?;
    let probe = checked.probe("mean2d_probe", extras.mean2d_probe.as_ref())?;
    let (splats, factors) = factored(&checked, splats, extras)?;
    Ok(projected(&checked, &splats, factors, camera, probe))
}

/// [`project`](fn@project) of inputs that have been checked, with the rotations and scales of [`factored`].
pub(super) fn projected(
    checked: &Checked,
    splats: &Splats,
    factors: bool,
    camera: &Camera,
    mean2d_probe: Tensor<2>,
) -> Projected {
    let (intrinsics, options) = (camera.intrinsics, checked.options);
    let spec = ProjectSpec { intrinsics, options: options.of_project(&intrinsics), factors };
    let inputs = Geometry {
        means: (&splats.means).into(),
        rotations: (&splats.rotations).into(),
        scales: (&splats.scales).into(),
        opacities: (&splats.opacities).into(),
        cam_from_world: (&camera.cam_from_world).into(),
        mean2d: mean2d_probe.into(),
    }
    .into_array();
    let ray_space = options.along_rays().then(|| apply(RaySpace(spec), inputs.clone()).float(0));
    Projected { packed: apply(Project(spec), inputs).float(0), ray_space, intrinsics }
}

const _: () = assert!(COLUMNS == 7, "the columns that `Projected::ellipses` names");
