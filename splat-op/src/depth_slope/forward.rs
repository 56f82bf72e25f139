//! Forward kernels of `depth_slope` and of the bounds: one unit per Gaussian. The code of `project` projects the Gaussians.

use cubecl::prelude::*;

use super::{DEPTH_SLOPE, EXTENT, LEAST, SLACK, THICKNESS_MAX};
use crate::gpu::math::{Pose, Vec3, finite};
use crate::project::forward::{Gaussian, PackedEllipse, ProjectCamera, ProjectionTerms, project_one};

/// Intermediate results of the forward pass that the backward pass needs again, with the names of the module's documentation.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct DepthSlopeTerms {
    /// False if the Gaussian has no depth slope, because it is culled or too long.
    pub sound: bool,
    /// `j`: the last row of `W R` over z; `mz`: `j` times the scales.
    pub j: Vec3,
    pub mz: Vec3,
    pub c: Vec3,
    pub p: Vec3,
    pub a: Vec3,
    pub b: f32,
    pub b_u: f32,
    pub depth_slope_u: f32,
    pub depth_slope_v: f32,
    pub thickness: f32,
    /// Whether the thickness is not clamped.
    pub free: bool,
}

#[cube]
pub(super) fn lean(projection: &ProjectionTerms, gaussian: &Gaussian, lens: &ProjectCamera) -> DepthSlopeTerms {
    let j = projection.last.times(1.0 / projection.depth);
    let mz = j.by_axis(gaussian.scale);
    let inverse_v = 1.0 / projection.sigma_v;
    let b_u = lens.blur_sigma / projection.sigma_u;
    let b = lens.blur_sigma * inverse_v;
    let p = projection.p.times(inverse_v);
    let a = projection.along.times(b);
    let c = projection.n.cross(mz);
    let length = mz.length();
    let rest = Vec3::new(a.cross(mz).length(), b * b_u * length, 0.0).length();
    let thickness = Vec3::new(mz.dot(p), b * c.length(), rest).length();
    let depth_slope_u = mz.dot(projection.n);
    let depth_slope_v = p.dot(c) + b_u * a.dot(mz);
    let held = min(thickness, comptime!(THICKNESS_MAX as f32));
    let known = finite(depth_slope_u) && finite(depth_slope_v) && finite(thickness);
    DepthSlopeTerms {
        sound: projection.visible && length <= 1e30 && known,
        j,
        mz,
        c,
        p,
        a,
        b,
        b_u,
        depth_slope_u,
        depth_slope_v,
        thickness: held,
        free: held == thickness,
    }
}

/// Writes the depth slopes, `[N, 3]`.
#[cube(launch_unchecked)]
pub(super) fn depth_slope_forward_kernel(
    means: &[f32],
    rotations: &[Vector<f32, Const<4>>],
    scales: &[f32],
    opacities: &[f32],
    cam_from_world: &[f32],
    depth_slopes: &mut [f32],
    lens: ProjectCamera,
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let gaussian = Gaussian::load(means, rotations, scales, opacities, ABSOLUTE_POS);
        let projection = project_one(&gaussian, &Pose::load(cam_from_world), &lens);
        let found = lean(&projection, &gaussian, &lens);
        let at = ABSOLUTE_POS * comptime!(DEPTH_SLOPE);
        depth_slopes[at] = select(found.sound, found.depth_slope_u, 0.0);
        depth_slopes[at + 1] = select(found.sound, found.depth_slope_v, 0.0);
        depth_slopes[at + 2] = select(found.sound, found.thickness, 0.0);
    }
}

/// Returns a row that covers the whole picture.
#[cube]
fn everywhere(e: &PackedEllipse, width: f32, height: f32, reached: f32, alpha_min: f32) -> PackedEllipse {
    PackedEllipse {
        x: width * 0.5,
        y: height * 0.5,
        sigma_u: width + height,
        shear: 0.0f32.runtime(),
        sigma_v: width + height,
        depth: e.depth,
        opacity: select(alpha_min > 0.0, reached, 1.0),
    }
}

/// Returns the row of a Gaussian, and whether its region is bounded.
#[cube]
fn bounding_ellipse(
    e: &PackedEllipse,
    depth_slope_u: f32,
    depth_slope_v: f32,
    thickness: f32,
    reached: f32,
    alpha_min: f32,
) -> (PackedEllipse, bool) {
    let least = comptime!(LEAST as f32);
    let faintest = max(alpha_min, f32::MIN_POSITIVE);
    let tau = 2.0 * (e.opacity / faintest).ln() * comptime!(1.0 + SLACK[0] as f32) + comptime!(SLACK[1] as f32);
    let across = thickness * tau.sqrt();
    let thin = 1.0 - across * across;
    let c = (tau / max(thin, least)).sqrt();
    // The eccentricity is `c` times the length of the depth slope.
    let eccentricity = c * Vec3::new(depth_slope_u, depth_slope_v, 0.0).length();
    let rest = (1.0 - eccentricity) * (1.0 + eccentricity);
    let ends = alpha_min > 0.0 && thin > least && rest > least && finite(thin) && finite(rest);
    let rest = max(rest, least);
    let root = rest.sqrt();
    let (shift_u, shift_v) = (-(c * depth_slope_u) * (c / rest), -(c * depth_slope_v) * (c / rest));
    let (g_u, g_v) = (c * depth_slope_u / root, c * depth_slope_v / root);
    let scale = c / (root * comptime!(EXTENT as f32));
    let wide = 1.0 + g_u * g_u;
    let row = PackedEllipse {
        x: e.x + e.sigma_u * shift_u,
        y: e.y + e.shear * e.sigma_u * shift_u + e.sigma_v * shift_v,
        sigma_u: scale * e.sigma_u * wide.sqrt(),
        shear: e.shear + e.sigma_v / e.sigma_u * (g_u * g_v / wide),
        sigma_v: scale * e.sigma_v * ((wide + g_v * g_v) / wide).sqrt(),
        depth: e.depth,
        opacity: reached,
    };
    let known = finite(row.x) && finite(row.y) && finite(row.sigma_u) && finite(row.shear) && finite(row.sigma_v);
    (row, ends && known)
}

/// Writes the bounds, `[N, 7]`.
#[cube(launch_unchecked)]
pub(super) fn bounds_kernel(
    projected: &[f32],
    depth_slopes: &[f32],
    bounds: &mut [f32],
    width: f32,
    height: f32,
    alpha_min: f32,
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let e = PackedEllipse::load(projected, ABSOLUTE_POS);
        let at = ABSOLUTE_POS * comptime!(DEPTH_SLOPE);
        if finite(e.opacity) && e.opacity > 0.0 && e.opacity >= alpha_min {
            let reached = alpha_min * comptime!((0.5 * EXTENT * EXTENT).exp() as f32);
            let (row, ends) =
                bounding_ellipse(&e, depth_slopes[at], depth_slopes[at + 1], depth_slopes[at + 2], reached, alpha_min);
            if ends {
                row.store(bounds, ABSOLUTE_POS);
            } else {
                everywhere(&e, width, height, reached, alpha_min).store(bounds, ABSOLUTE_POS);
            }
        } else {
            e.store(bounds, ABSOLUTE_POS);
        }
    }
}
