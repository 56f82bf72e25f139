//! The yardstick: a render in float64 without cut-off, tiles, or any other approximation, to be believed by reading.
//!
//! It follows the model choices of [`RenderOptions`] (`blur`, `near`, `jacobian_margin`, `antialias`) and ignores its
//! numerical dials. It shares no arithmetic with the stages but a camera's limits (how far a lens sees, the slopes at which
//! the Jacobian is held): covariances are formed and inverted as the papers write them, which in float64 costs digits only
//! for Gaussians some 1e6 times longer than wide. Every pixel visits every Gaussian, so it is for proofs, not pictures.

mod lens;

use glam::{DMat2, DMat3, DQuat, DVec2, DVec3};

use crate::camera::Intrinsics;
use crate::options::RenderOptions;
use crate::project::COMPENSATION_MIN;

/// One Gaussian with activated parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct ExactGaussian {
    /// Centre, world frame.
    pub mean: DVec3,
    /// Quaternion wxyz, world-from-Gaussian, of any non-zero length.
    pub rotation: [f64; 4],
    /// Standard deviations along the rotated axes.
    pub scale: DVec3,
    /// 0 to 1.
    pub opacity: f64,
    /// Colour or features, as blended.
    pub features: Vec<f64>,
}

/// Where the camera stands: `mean_cam = rotation * mean_world + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExactPose {
    /// Camera-from-world.
    pub rotation: DMat3,
    /// Camera-from-world.
    pub translation: DVec3,
}

/// What one pixel sees.
#[derive(Clone, Debug, PartialEq)]
pub struct ExactPixel {
    /// `Σ wᵢ cᵢ + T background`.
    pub features: Vec<f64>,
    /// `1 − T`.
    pub alpha: f64,
    /// `Σ wᵢ zᵢ`.
    pub depth: f64,
}

/// A Gaussian on the picture.
struct Ellipse<'a> {
    mean_px: DVec2,
    /// Inverse of the 2D covariance, px⁻².
    conic: DMat2,
    depth: f64,
    opacity: f64,
    features: &'a [f64],
}

/// All pixels of a picture, row by row.
pub fn render_exact(
    gaussians: &[ExactGaussian],
    pose: &ExactPose,
    camera: &Intrinsics,
    background: &[f64],
    options: &RenderOptions,
) -> Vec<ExactPixel> {
    let mut ellipses: Vec<Ellipse> = gaussians.iter().filter_map(|g| project(g, pose, camera, options)).collect();
    // Stable: Gaussians at one depth keep their order.
    ellipses.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    let centres = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y)));
    centres.map(|(x, y)| pixel(&ellipses, DVec2::new(x as f64 + 0.5, y as f64 + 0.5), background)).collect()
}

fn pixel(ellipses: &[Ellipse], centre_px: DVec2, background: &[f64]) -> ExactPixel {
    let mut transmittance = 1.0;
    let mut out = ExactPixel { features: vec![0.0; background.len()], alpha: 0.0, depth: 0.0 };
    for ellipse in ellipses {
        let d = centre_px - ellipse.mean_px;
        let alpha = ellipse.opacity * (-0.5 * d.dot(ellipse.conic * d)).exp();
        let weight = transmittance * alpha;
        out.features.iter_mut().zip(ellipse.features).for_each(|(sum, c)| *sum += weight * c);
        out.depth += weight * ellipse.depth;
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
) -> Option<Ellipse<'a>> {
    let mean_cam = pose.rotation * gaussian.mean + pose.translation;
    let DVec3 { x, y, z } = mean_cam;
    if z <= options.near {
        return None;
    }
    let [qw, qx, qy, qz] = gaussian.rotation;
    let rotation = DMat3::from_quat(DQuat::from_xyzw(qx, qy, qz, qw).normalize());
    let axes = rotation * DMat3::from_diagonal(gaussian.scale);
    let covariance_world = axes * axes.transpose();
    let covariance_cam = pose.rotation * covariance_world * pose.rotation.transpose();

    // The Jacobian of a perspective camera is taken no further outside the picture than the margin; that of a fisheye is exact.
    let [[low_x, high_x], [low_y, high_y]] = camera.slope_limits(options.jacobian_margin);
    let held = match camera.model.is_fisheye() {
        true => mean_cam,
        false => DVec3::new((x / z).clamp(low_x, high_x) * z, (y / z).clamp(low_y, high_y) * z, z),
    };
    let mean_px = lens::seen(camera, mean_cam)?.map(|dual| dual.value);
    let [j0, j1] = lens::seen(camera, held)?.map(|dual| dual.grad);
    let (c0, c1) = (covariance_cam * j0, covariance_cam * j1);
    let sharp = DMat2::from_cols(DVec2::new(j0.dot(c0), j1.dot(c0)), DVec2::new(j0.dot(c1), j1.dot(c1)));
    let covariance = sharp + DMat2::from_diagonal(DVec2::splat(options.blur));
    let compensation = if options.antialias {
        (sharp.determinant() / covariance.determinant()).max(0.0).sqrt().max(COMPENSATION_MIN)
    } else {
        1.0
    };
    Some(Ellipse {
        mean_px: DVec2::from_array(mean_px),
        conic: covariance.inverse(),
        depth: z,
        opacity: gaussian.opacity * compensation,
        features: &gaussian.features,
    })
}
