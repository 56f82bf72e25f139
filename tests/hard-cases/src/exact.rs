//! Reference renderer: float64, without cut-offs, tiles or any other approximation, and simple enough to verify by reading.
//!
//! It follows the model choices of [`RenderOptions`] (`blur`, `near`, `far`, `radius_clip`, `jacobian_margin`, `antialias`,
//! `projection`) and ignores its numerical dials. It alone can order each pixel by itself ([`ExactView::sorted_per_pixel`]), which
//! says what the order of the centres costs. It shares no arithmetic with the stages except a camera's limits (the domain of a lens
//! and the slopes at which the Jacobian is clamped). Covariances are formed and inverted as the papers write them, which in float64 loses
//! digits only for Gaussians some 1e6 times longer than wide. Every pixel visits every Gaussian, so it is for tests, not for
//! pictures.

mod lens;
mod ray;

use burn::tensor::Tensor;
use glam::{DMat2, DMat3, DQuat, DVec2, DVec3};
use splat_op::test_hooks::slope_limits;
use splat_op::{Camera, CameraModel, Intrinsics, Projection, RenderOptions, SplatError, Splats, colours};

use self::ray::{Ray, Solid};

/// Half of an ellipse's extent, which `radius_clip` compares, in standard deviations.
const RADIUS_SIGMAS: f64 = 3.0;

/// Least factor of the compensation of `antialias`.
const COMPENSATION_MIN: f64 = 0.005;

/// One Gaussian with activated parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct ExactGaussian {
    /// Centre, world frame, scene units.
    pub mean: DVec3,
    /// Quaternion wxyz, world-from-Gaussian, of any non-zero length.
    pub rotation: [f64; 4],
    /// Standard deviations along the rotated axes, scene units.
    pub scale: DVec3,
    /// Opacity, 0 to 1.
    pub opacity: f64,
    /// Colour or features, blended unchanged.
    pub features: Vec<f64>,
}

/// Pose of the camera: `mean_cam = rotation * mean_world + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExactPose {
    /// Rotation, camera-from-world.
    pub rotation: DMat3,
    /// Translation, camera-from-world, scene units.
    pub translation: DVec3,
}

/// Reads from tensors the Gaussians that can be rendered, with their colours as seen by `camera`, and the camera's pose. Tensors in f64
/// lose no digits.
///
/// # Errors
/// If the shapes of the tensors do not fit each other.
pub fn read(splats: &Splats, camera: &Camera) -> Result<(Vec<ExactGaussian>, ExactPose), SplatError> {
    fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
        tensor.into_data().iter::<f64>().collect()
    }
    let colours = host(colours(splats, camera)?);
    let (means, rotations) = (host(splats.means.clone()), host(splats.rotations.clone()));
    let (scales, opacities) = (host(splats.scales.clone()), host(splats.opacities.clone()));
    let channels = colours.len() / opacities.len().max(1);
    let gaussian = |i: usize| ExactGaussian {
        mean: DVec3::from_slice(&means[3 * i..]),
        rotation: std::array::from_fn(|k| rotations[4 * i + k]),
        scale: DVec3::from_slice(&scales[3 * i..]),
        opacity: opacities[i],
        features: colours[channels * i..channels * (i + 1)].to_vec(),
    };
    let rows = host(camera.cam_from_world.clone());
    let row = |i: usize| DVec3::from_slice(&rows[4 * i..]);
    let pose = ExactPose {
        rotation: DMat3::from_cols(row(0), row(1), row(2)).transpose(),
        translation: DVec3::new(rows[3], rows[7], rows[11]),
    };
    // Gaussians of opacity 0 are masked; their other values may be anything.
    Ok(((0..opacities.len()).filter(|&i| opacities[i] > 0.0).map(gaussian).collect(), pose))
}

/// One pixel of the reference render.
#[derive(Clone, Debug, PartialEq)]
pub struct ExactPixel {
    /// Blended features, `Σ wᵢ cᵢ + T background`.
    pub features: Vec<f64>,
    /// Alpha, `1 − T` with the transmittance `T` behind the last Gaussian.
    pub alpha: f64,
    /// Depth `Σ wᵢ zᵢ`, scene units, not divided by alpha.
    pub depth: f64,
}

/// A projected Gaussian.
struct ExactEllipse<'a> {
    mean_px: DVec2,
    /// Inverse of the 2D covariance, px⁻².
    conic: DMat2,
    depth: f64,
    opacity: f64,
    /// The Gaussian in space.
    solid: Solid,
    features: &'a [f64],
}

/// What a Gaussian contributes to a pixel.
struct LayerInPixel<'a> {
    alpha: f64,
    depth: f64,
    /// Sort key: a depth.
    key: f64,
    features: &'a [f64],
}

/// A picture of which single pixels can be rendered: the Gaussians as a camera sees them.
pub struct ExactView<'a> {
    ellipses: Vec<ExactEllipse<'a>>,
    camera: Intrinsics,
    options: RenderOptions,
    sorted_per_pixel: bool,
}

/// Renders a picture with the reference renderer and returns its pixels row by row.
///
/// `background` has as many channels as the features of each Gaussian. Equations: Zwicker et al. 2001, eq. 26 to 31, and Kerbl et
/// al. 2023, eq. 5, for the projection; the maximum along the ray for [`Projection::RayMax`]. Rays of a lens are those that its
/// projection maps to the pixels' centres; with [`Projection::RayMax`], a pixel without a ray shows the background.
pub fn render_exact(
    gaussians: &[ExactGaussian],
    pose: &ExactPose,
    camera: &Intrinsics,
    background: &[f64],
    options: &RenderOptions,
) -> Vec<ExactPixel> {
    let view = ExactView::new(gaussians, pose, camera, options);
    let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| [x, y]));
    pixels.map(|pixel| view.pixel(pixel, background)).collect()
}

impl<'a> ExactView<'a> {
    /// Projects the Gaussians once for all pixels.
    pub fn new(gaussians: &'a [ExactGaussian], pose: &ExactPose, camera: &Intrinsics, options: &RenderOptions) -> Self {
        let ellipses = gaussians.iter().filter_map(|g| project(g, pose, camera, options)).collect();
        Self { ellipses, camera: *camera, options: *options, sorted_per_pixel: false }
    }

    /// Orders the contributions to each pixel by the camera z of each Gaussian's maximum along the pixel's ray (Radl et al. 2024,
    /// StopThePop) instead of by the camera z of the centres. A pixel without a ray then shows the background.
    pub fn sorted_per_pixel(self) -> Self {
        Self { sorted_per_pixel: true, ..self }
    }

    /// Renders the pixel in column `x` and row `y` by visiting every Gaussian. `background` has a value for each feature.
    pub fn pixel(&self, [x, y]: [usize; 2], background: &[f64]) -> ExactPixel {
        self.position(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), background)
    }

    /// Renders a position of the picture, px, as [`Self::pixel`] renders the centre of a pixel.
    pub fn position(&self, px: DVec2, background: &[f64]) -> ExactPixel {
        let needs_ray = self.options.projection == Projection::RayMax || self.sorted_per_pixel;
        let ray = if needs_ray { lens::ray(&self.camera, px) } else { None };
        let seen = self.ellipses.iter().map(|ellipse| match ray {
            Some(ray) => ellipse.on_ray(px, ray, &self.options, self.sorted_per_pixel),
            None => ellipse.at(px, if needs_ray { 0.0 } else { 1.0 }),
        });
        let mut seen: Vec<LayerInPixel> = seen.collect();
        // The sort is stable: Gaussians at equal depths keep their order.
        seen.sort_by(|a, b| a.key.total_cmp(&b.key));
        pixel(&seen, background)
    }
}

impl<'a> ExactEllipse<'a> {
    /// The ellipse at a position of the picture, dimmed by a factor.
    fn at(&self, px: DVec2, dimmed: f64) -> LayerInPixel<'a> {
        let d = px - self.mean_px;
        let alpha = dimmed * self.opacity * (-0.5 * d.dot(self.conic * d)).exp();
        LayerInPixel { alpha, depth: self.depth, key: self.depth, features: self.features }
    }

    /// The Gaussian along the ray of that position, whose direction has z one, perhaps with the maximum as its key.
    fn on_ray(&self, px: DVec2, ray: Ray, options: &RenderOptions, by_pixel: bool) -> LayerInPixel<'a> {
        let (mut seen, solid) = (self.at(px, 1.0), &self.solid);
        let met = solid.meet(solid.on_screen_ray(ray));
        if options.projection == Projection::RayMax {
            // A maximum behind the camera is not visible.
            seen.alpha = if met.at > 0.0 { self.opacity * met.value } else { 0.0 };
            seen.depth = met.at;
        }
        if by_pixel {
            seen.key = met.at;
        }
        seen
    }
}

fn pixel(seen: &[LayerInPixel], background: &[f64]) -> ExactPixel {
    let mut transmittance = 1.0;
    let mut out = ExactPixel { features: vec![0.0; background.len()], alpha: 0.0, depth: 0.0 };
    for LayerInPixel { alpha, depth, features, .. } in seen {
        let weight = transmittance * alpha;
        out.features.iter_mut().zip(*features).for_each(|(sum, c)| *sum += weight * c);
        out.depth += weight * depth;
        transmittance *= 1.0 - alpha;
    }
    out.features.iter_mut().zip(background).for_each(|(sum, c)| *sum += transmittance * c);
    out.alpha = 1.0 - transmittance;
    out
}

fn project<'a>(
    gaussian: &'a ExactGaussian,
    pose: &ExactPose,
    camera: &Intrinsics,
    options: &RenderOptions,
) -> Option<ExactEllipse<'a>> {
    let mean_cam = pose.rotation * gaussian.mean + pose.translation;
    let DVec3 { x, y, z } = mean_cam;
    if z <= options.near || z >= options.far {
        return None;
    }
    let [qw, qx, qy, qz] = gaussian.rotation;
    let rotation = DMat3::from_quat(DQuat::from_xyzw(qx, qy, qz, qw).normalize());
    let axes = rotation * DMat3::from_diagonal(gaussian.scale);
    let covariance_world = axes * axes.transpose();
    let covariance_cam = pose.rotation * covariance_world * pose.rotation.transpose();

    // The Jacobian of a perspective camera is evaluated at most the margin outside the picture, and within the picture for
    // `RayMax`, which takes no more than the compensation from it. Other Jacobians are not clamped.
    let [[low_x, high_x], [low_y, high_y]] = slope_limits(camera, options);
    let parallel = camera.model == CameraModel::Orthographic;
    let held = match camera.model.is_fisheye() || parallel {
        true => mean_cam,
        false => DVec3::new((x / z).clamp(low_x, high_x) * z, (y / z).clamp(low_y, high_y) * z, z),
    };
    let mean_px = lens::seen(camera, mean_cam)?.map(|dual| dual.value);
    let [j0, j1] = lens::seen(camera, held)?.map(|dual| dual.grad);
    let (c0, c1) = (covariance_cam * j0, covariance_cam * j1);
    let sharp = DMat2::from_cols(DVec2::new(j0.dot(c0), j1.dot(c0)), DVec2::new(j0.dot(c1), j1.dot(c1)));
    let covariance = sharp + DMat2::from_diagonal(DVec2::splat(options.blur));
    let widest = covariance.x_axis.x.max(covariance.y_axis.y).sqrt();
    if RADIUS_SIGMAS * widest <= options.radius_clip {
        return None;
    }
    let compensation = if options.antialias {
        (sharp.determinant() / covariance.determinant()).max(0.0).sqrt().max(COMPENSATION_MIN)
    } else {
        1.0
    };
    let solid = match options.projection {
        Projection::Affine if !parallel => Solid::on_screen(mean_cam, covariance_cam, [j0, j1], options.blur),
        _ => Solid::in_camera(mean_cam, covariance_cam, [j0, j1], options.blur),
    };
    Some(ExactEllipse {
        mean_px: DVec2::from_array(mean_px),
        conic: covariance.inverse(),
        depth: z,
        opacity: gaussian.opacity * compensation,
        solid,
        features: &gaussian.features,
    })
}
