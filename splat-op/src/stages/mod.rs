//! The stages of a render as public functions. Tensor code may run between them.

// The stages, in the order in which data flows; the blank lines keep rustfmt from sorting them.
pub mod project;

pub mod sh;

pub mod intersect;

pub mod rasterize;

// What `rasterize` takes in place of ellipses for Gaussians seen along rays.
pub mod ray_space;

pub mod rasterize_rays;

// Their inputs, and all of them in one call.
pub(crate) mod colour;
pub(crate) mod contributors;
pub(crate) mod normals;
pub mod options;
pub(crate) mod projected;
pub(crate) mod render;
pub(crate) mod splats;
pub(crate) mod tile_mask;

use burn::tensor::{Int, Tensor};

pub use self::projected::{Ellipses, Projected};
use self::splats::{Colour, Extras, Splats, sh_need};
use crate::abilities::check_fits;
use crate::backend::{Slot, apply};
use crate::camera::{Camera, Intrinsics};
use crate::check::{Reference, check_positive};
use crate::error::SplatError;
use crate::intersect::operation::Intersect;
use crate::intersect::{Kept, tile_grid};
use crate::limits::Need;
use crate::options::RenderOptions;
use crate::project::operation::Project;
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::rasterize::RasterizeSpec;
use crate::rasterize::operation::Rasterize;
use crate::ray_space::operation::{Bounds, RaySpace};

/// The intersections of Gaussians and tiles of one view, as [`intersect`](fn@intersect) returns them.
#[derive(Clone, Debug)]
pub struct Intersections {
    /// `[tiles along y, tiles along x]`: number of Gaussians listed in each tile of 16 × 16 px.
    pub counts: Tensor<2, Int>,
    lists: Kept,
    /// Number of Gaussians, and what else the lists depend on.
    of: (usize, RasterizeSpec),
}

/// Rendered pictures: `Rendered<3>` holds the picture of one camera, `[H, W, …]`; `Rendered<4>` holds those of several cameras,
/// `[B, H, W, …]`. All fields are differentiable.
#[derive(Clone, Debug)]
pub struct Rendered<const D: usize> {
    /// `[.., H, W, C]`: colours or features over the background.
    pub colour: Tensor<D>,
    /// `[.., H, W, 1]`: alpha, `1 − T` with the transmittance `T` behind the last Gaussian.
    pub alpha: Tensor<D>,
    /// `[.., H, W, 1]`: depth `Σ wᵢ zᵢ`, scene units, not divided by alpha; present if `options.depth` is set.
    pub depth: Option<Tensor<D>>,
}

impl<const D: usize> Rendered<D> {
    /// Returns the depth divided by alpha, `[.., H, W, 1]`, scene units: the mean depth of what a pixel shows. It is zero where nothing is.
    /// Present if `options.depth` was set. The divisor is at least 1e-10, as in gsplat.
    pub fn expected_depth(&self) -> Option<Tensor<D>> {
        self.depth.clone().map(|depth| depth / self.alpha.clone().clamp_min(1e-10))
    }
}

/// Whether lists made with some options hold what a render with others needs: a smaller `alpha_min` lists more.
fn lists_serve(made: &RenderOptions, options: &RenderOptions) -> bool {
    made.alpha_min <= options.alpha_min && *made == RenderOptions { alpha_min: made.alpha_min, ..*options }
}

impl Intersections {
    /// Refuses lists of other Gaussians, of another picture or of other options: kernels do not check the indices in them.
    fn check(&self, count: usize, spec: &RasterizeSpec) -> Result<(), SplatError> {
        let (listed, of) = &self.of;
        let size = |of: &Intrinsics| format!("{} × {} px", of.width, of.height);
        let found = if *listed != count {
            format!("lists of {listed} Gaussians, for {count}")
        } else if size(&of.intrinsics) != size(&spec.intrinsics) {
            format!("lists of {}, for {}", size(&of.intrinsics), size(&spec.intrinsics))
        } else if of.intrinsics != spec.intrinsics {
            "lists of another camera".into()
        } else if !lists_serve(&of.options, &spec.options) {
            format!("lists with {:?}, for {:?}", of.options, spec.options)
        } else {
            return Ok(());
        };
        let expected = "the result of `intersect` on these ellipses, with these options or a smaller `alpha_min`";
        Err(SplatError::Value { field: "intersections", found, expected })
    }
}

/// Projects Gaussians onto a camera's picture: EWA splatting (Zwicker et al. 2001), as in Kerbl et al. 2023, section 4.
///
/// Returns `N` ellipses, in px. Differentiable in the means, rotations, scales, opacities and the pose. Of `extras`, only
/// `mean2d_probe` is read.
///
/// A Gaussian is culled if one of its values is not finite, if its quaternion is zero, if the camera z of its centre is at most
/// `options.near` or at least `options.far`, if it reaches at most `options.radius_clip`, or if its centre lies outside the domain of the
/// camera's lens ([`Intrinsics::max_radius`]). The opacity, the depth and the gradients of a culled Gaussian are zero. Both planes are depths
/// for every camera model, so a fisheye sees nothing at 90° or more from its axis.
///
/// # Errors
/// If a tensor's shape, type or device does not fit, or if the camera or an option is out of range.
pub fn project(
    splats: &Splats,
    camera: &Camera,
    extras: &Extras,
    options: &RenderOptions,
) -> Result<Projected, SplatError> {
    let reference = check_geometry(splats, camera, options)?;
    let probe = probe_or_empty(&reference, "mean2d_probe", extras.mean2d_probe.as_ref(), splats.means.dims()[0])?;
    reference.check_fits(&[packed_need(splats.means.dims()[0])])?;
    let spec = ProjectSpec { intrinsics: camera.intrinsics, options: options.of_project(&camera.intrinsics) };
    let inputs = Geometry {
        means: (&splats.means).into(),
        rotations: (&splats.rotations).into(),
        scales: (&splats.scales).into(),
        opacities: (&splats.opacities).into(),
        cam_from_world: (&camera.cam_from_world).into(),
        mean2d: probe.into(),
    }
    .into_array();
    let ray_space = options.along_rays().then(|| apply(RaySpace(spec), inputs.clone()).float(0));
    let packed = apply(Project(spec), inputs).float(0);
    Ok(Projected { packed, ray_space, intrinsics: camera.intrinsics })
}

/// Lists the Gaussians that can show in each tile of 16 × 16 px, front to back. Not differentiable.
///
/// # Errors
/// If an option is out of range, if `projected` was not made with `options.projection`, or if
/// `options.alpha_min` is zero and there are more than [`crate::MAX_UNCULLED_INTERSECTIONS`] pairs of a Gaussian and a tile.
pub fn intersect(projected: &Projected, options: &RenderOptions) -> Result<Intersections, SplatError> {
    lists_of(projected, None, options)
}

/// Lists the Gaussians in the tiles of a mask, i32, or in all tiles.
fn lists_of(
    projected: &Projected,
    mask: Option<Tensor<2, Int>>,
    options: &RenderOptions,
) -> Result<Intersections, SplatError> {
    options.check()?;
    let [tiles_x, tiles_y] = tile_grid(projected.intrinsics.width, projected.intrinsics.height);
    options.check_uncut(projected.len(), tiles_x * tiles_y)?;
    check_rays(projected, options)?;
    check_fits(&projected.packed.device(), &[packed_need(projected.len())])?;
    let lists = Kept::default();
    let spec = RasterizeSpec { intrinsics: projected.intrinsics, options: *options };
    let mut packed = projected.packed.clone().detach();
    if let Some(ray_space) = &projected.ray_space {
        packed = apply(Bounds(spec), [packed.into(), ray_space.clone().detach().into()]).float(0);
    }
    let counts = apply(Intersect { spec, lists: lists.clone() }, [packed.into(), mask.into()]).int(0);
    Ok(Intersections { counts, lists, of: (projected.len(), spec) })
}

/// Rasterizes features `[N, C]`: blends the Gaussians of each tile front to back over `extras.background`.
///
/// Returns a picture `[H, W, C]`, its alpha and, if asked for, its depth. Differentiable in the ellipses, the features and the
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
) -> Result<Rendered<3>, SplatError> {
    rasterized(projected, features, intersections, extras, options, None)
}

/// [`rasterize`](fn@rasterize) without extras, which keeps a trace.
#[cfg(feature = "cube")]
pub(crate) fn traced(
    projected: &Projected,
    features: &Tensor<2>,
    intersections: &Intersections,
    options: &RenderOptions,
    trace: &Kept,
) -> Result<Rendered<3>, SplatError> {
    rasterized(projected, features, intersections, &Extras::default(), options, Some(trace.clone()))
}

fn rasterized(
    projected: &Projected,
    features: &Tensor<2>,
    intersections: &Intersections,
    extras: &Extras,
    options: &RenderOptions,
    trace: Option<Kept>,
) -> Result<Rendered<3>, SplatError> {
    options.check()?;
    check_rays(projected, options)?;
    let reference = Reference::new("projected", &projected.packed)?;
    let count = projected.len();
    reference.check("features", features, [Some(count), None], "[N, C]")?;
    let channels = features.dims()[1];
    check_positive("features", channels, "at least one channel")?;
    reference.check_fits(&rasterize_needs(features.dims(), &projected.intrinsics, options))?;
    let background = match &extras.background {
        Some(background) => background.clone(),
        None => Tensor::zeros([channels], reference.options()),
    };
    reference.check("background", &background, [Some(channels)], "[C]")?;
    let probe = probe_or_empty(&reference, "mean2d_abs_probe", extras.mean2d_abs_probe.as_ref(), count)?;
    reference.check_device("intersections", &intersections.counts.device())?;
    let spec = RasterizeSpec { intrinsics: projected.intrinsics, options: *options };
    intersections.check(count, &spec)?;
    let (counts, lists) = (&intersections.counts, intersections.lists.clone());
    let ray_space = projected.ray_space.as_ref().map_or(Slot::Absent, Slot::from);
    let inputs =
        [(&projected.packed).into(), features.into(), background.into(), probe.into(), ray_space, counts.into()];
    let mut planes = apply(Rasterize { spec, lists, trace }, inputs);
    let mut picture = |i: usize| planes.float::<3>(i).permute([1, 2, 0]);
    Ok(Rendered { colour: picture(0), alpha: picture(1), depth: options.depth.then(|| picture(2)) })
}

fn check_geometry(splats: &Splats, camera: &Camera, options: &RenderOptions) -> Result<Reference, SplatError> {
    options.check()?;
    camera.intrinsics.check()?;
    let reference = Reference::new("means", &splats.means)?;
    let count = splats.means.dims()[0];
    reference.check("means", &splats.means, [None, Some(3)], "[N, 3]")?;
    reference.check("rotations", &splats.rotations, [Some(count), Some(4)], "[N, 4]")?;
    reference.check("scales", &splats.scales, [Some(count), Some(3)], "[N, 3]")?;
    reference.check("opacities", &splats.opacities, [Some(count)], "[N]")?;
    reference.check("cam_from_world", &camera.cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
    Ok(reference)
}

/// Refuses ellipses without rows in ray space for per-ray rasterization, and ellipses with them for plain rasterization.
fn check_rays(projected: &Projected, options: &RenderOptions) -> Result<(), SplatError> {
    let found = format!("{:?}", options.projection);
    match (options.along_rays(), projected.ray_space.is_some()) {
        (true, false) => Err(SplatError::Value {
            field: "projection",
            found,
            expected: "Affine for ellipses that were packed from fields, or projected with these options",
        }),
        (false, true) => Err(SplatError::Value {
            field: "projection",
            found,
            expected: "the projection that the ellipses were projected with",
        }),
        _ => Ok(()),
    }
}

/// Checks the buffer sizes of all stages of a render of `cameras` pictures before the first stage runs.
pub(crate) fn check_render_fits(
    splats: &Splats,
    cameras: usize,
    intrinsics: &Intrinsics,
    options: &RenderOptions,
) -> Result<(), SplatError> {
    let count = splats.means.dims()[0];
    let channels = if let Colour::Features(features) = &splats.colour { features.dims()[1] } else { 3 };
    let shape = [cameras, channels, intrinsics.height, intrinsics.width];
    let pictures = Need::floats("the pictures of all cameras", shape, "render fewer cameras in one call");
    let needs = rasterize_needs([count, channels], intrinsics, options);
    let all: Vec<Need> = needs
        .into_iter()
        .chain(splats.colour.blocks().iter().map(sh_need))
        .chain([packed_need(count), pictures])
        .collect();
    check_fits(&splats.means.device(), &all)
}

fn packed_need(count: usize) -> Need {
    Need::floats("projected", [count, COLUMNS], "use fewer Gaussians")
}

fn rasterize_needs(features: [usize; 2], intrinsics: &Intrinsics, options: &RenderOptions) -> [Need; 2] {
    let planes = RasterizeSpec { intrinsics: *intrinsics, options: *options }.planes(features[1]);
    let picture = [planes, intrinsics.height, intrinsics.width];
    [
        Need::floats("features", features, "use fewer Gaussians or fewer channels"),
        Need::floats("the picture", picture, "render a smaller picture, parts of it one by one, or fewer channels"),
    ]
}

fn probe_or_empty(
    reference: &Reference,
    name: &'static str,
    probe: Option<&Tensor<2>>,
    count: usize,
) -> Result<Tensor<2>, SplatError> {
    match probe {
        None => Ok(Tensor::zeros([0, 2], reference.options())),
        Some(probe) => {
            reference.check(name, probe, [Some(count), Some(2)], "[N, 2]")?;
            Ok(probe.clone())
        }
    }
}
