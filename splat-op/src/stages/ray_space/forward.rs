//! Forward kernel of `ray_space`: one unit per Gaussian. The code of `project` projects the Gaussians.

use cubecl::prelude::*;

use super::lens_bounds_kernel::{LensFrame, jacobian_at};
use super::{LENS_FRAME, RAY_SPACE, THICKNESS_MAX};
use crate::gpu::math::{Vec2, Vec3, finite};
use crate::project::forward::{Gaussian, GeometryInputs, ProjectCamera, ProjectionTerms, project_one};

/// Intermediate results of the forward pass that the backward pass needs again, with the names of the module's documentation.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct RaySpaceTerms {
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
pub(super) fn lean(projection: &ProjectionTerms, gaussian: &Gaussian, camera: &ProjectCamera) -> RaySpaceTerms {
    let j = projection.last.times(1.0 / projection.depth);
    let mz = j.by_axis(gaussian.scale);
    let inverse_v = 1.0 / projection.sigma_v;
    let b_u = camera.blur_sigma / projection.sigma_u;
    let b = camera.blur_sigma * inverse_v;
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
    RaySpaceTerms {
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

/// Returns the offset of the centre from the origin, px; zero with a lens.
#[cube]
fn away(projection: &ProjectionTerms, camera: &ProjectCamera) -> (f32, f32) {
    let mut x = 0.0f32.runtime();
    let mut y = 0.0f32.runtime();
    if comptime!(camera.distortion.is_none()) {
        x = camera.x.focal * (projection.x.ratio - projection.x.slope);
        y = camera.y.focal * (projection.y.ratio - projection.y.slope);
    }
    (x, y)
}

/// Writes the rows, `[N, 9]`, with a lens `[N, 15]`.
#[cube(launch_unchecked)]
pub(super) fn ray_space_forward_kernel(
    inputs: GeometryInputs,
    ray_rows: &mut [f32],
    camera: ProjectCamera,
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let (gaussian, pose) = (inputs.gaussian(ABSOLUTE_POS), inputs.pose());
        let projection = project_one(&gaussian, &pose, &camera);
        let found = lean(&projection, &gaussian, &camera);
        let at = ABSOLUTE_POS * comptime!(RAY_SPACE + if camera.distortion.is_some() { LENS_FRAME } else { 0 });
        let seen = projection.visible;
        ray_rows[at] = select(found.sound, found.depth_slope_u, 0.0);
        ray_rows[at + 1] = select(found.sound, found.depth_slope_v, 0.0);
        ray_rows[at + 2] = select(found.sound, found.thickness, 0.0);
        ray_rows[at + 3] = select(seen, 1.0f32, 0.0);
        let (away_x, away_y) = away(&projection, &camera);
        ray_rows[at + 4] = select(seen, away_x, 0.0);
        ray_rows[at + 5] = select(seen, away_y, 0.0);
        ray_rows[at + 6] = select(seen, projection.sigma_u, 0.0);
        ray_rows[at + 7] = select(seen, projection.shear, 0.0);
        ray_rows[at + 8] = select(seen, projection.sigma_v, 0.0);
        #[comptime]
        if let ComptimeOption::Some(distortion) = camera.distortion {
            let mean = pose.apply(gaussian.mean);
            let (x, y, _bent) = jacobian_at(mean, &camera, &distortion);
            let frame = LensFrame {
                centre: Vec2::new(mean.x / mean.z, mean.y / mean.z),
                x: Vec2::new(mean.z * x.x, mean.z * x.y),
                y: Vec2::new(mean.z * y.x, mean.z * y.y),
            };
            frame.store(ray_rows, ABSOLUTE_POS, seen);
        }
    }
}
