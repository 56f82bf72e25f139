//! Forward kernel of `ray_space`: one unit per Gaussian. The code of `project` projects the Gaussians.

use cubecl::prelude::*;

use super::formulas::{Factored, RaySpaceTerms};
use super::{LENS_COLUMNS, LensFrame, RAY_SPACE};
use crate::gpu::{KernelMask, KernelNumber, Mat3, Vec2, Vec3, store_row};
use crate::project::forward::{
    Gaussian, GaussianExpand, GeometryInputs, ProjectCamera, ProjectionTerms, ProjectionTermsExpand, project_one,
};
use crate::project::lens_kernel::{DistortionArg, bent_rows};

/// The linear map at a Gaussian: the slopes `t` and the rows of `G`, px per slope; with a lens the columns of a row.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct KernelFrame {
    pub centre: Vec2,
    pub x: Vec2,
    pub y: Vec2,
}

impl KernelFrameExpand {
    /// The map as numbers.
    pub(super) fn numbers<'a>(&self, scope: &'a Scope) -> LensFrame<KernelNumber<'a>> {
        let [centre, x, y] = [self.centre, self.x, self.y]
            .map(|pair| [KernelNumber::of(scope, pair.x), KernelNumber::of(scope, pair.y)]);
        LensFrame { centre, by: [x, y] }
    }
}

/// `W R` of a Gaussian that is not rotated against the camera.
#[cube]
pub(super) fn not_rotated() -> Mat3 {
    Mat3 { x: Vec3::new(1.0, 0.0, 0.0), y: Vec3::new(0.0, 1.0, 0.0), z: Vec3::new(0.0, 0.0, 1.0) }
}

/// Returns the map of a lens at a centre in the camera's frame, and the rows of the lens's Jacobian there.
#[cube]
pub(super) fn lens_map(
    mean_cam: Vec3,
    camera: &ProjectCamera,
    distortion: &DistortionArg,
) -> (KernelFrame, (Vec3, Vec3)) {
    let one = Vec3::new(1.0, 1.0, 1.0);
    let (x, y, _within) = bent_rows(mean_cam, not_rotated(), one, &camera.x, &camera.y, distortion);
    let z = mean_cam.z;
    let map = KernelFrame {
        centre: Vec2::new(mean_cam.x / z, mean_cam.y / z),
        x: Vec2::new(z * x.j.x, z * x.j.y),
        y: Vec2::new(z * y.j.x, z * y.j.y),
    };
    (map, (x.j, y.j))
}

/// Returns the terms of a Gaussian, from its projection.
pub(super) fn terms_of<'a>(
    scope: &'a Scope,
    f: &ProjectionTermsExpand,
    g: &GaussianExpand,
    blur_sigma: NativeExpand<f32>,
) -> RaySpaceTerms<KernelNumber<'a>> {
    RaySpaceTerms::new(Factored {
        n: KernelNumber::vector(scope, f.n),
        along: KernelNumber::vector(scope, f.along),
        p: KernelNumber::vector(scope, f.p),
        sigma_u: KernelNumber::of(scope, f.sigma_u),
        shear: KernelNumber::of(scope, f.shear),
        sigma_v: KernelNumber::of(scope, f.sigma_v),
        last: KernelNumber::vector(scope, f.cam_from_gaussian.z),
        depth: KernelNumber::of(scope, f.mean_cam.z),
        scale: KernelNumber::vector(scope, g.scale),
        blur_sigma: KernelNumber::of(scope, blur_sigma),
    })
}

#[cube]
fn row_of(f: &ProjectionTerms, g: &Gaussian, blur_sigma: f32, away: Vec2) -> Sequence<f32> {
    intrinsic!(|scope| {
        let away = [KernelNumber::of(scope, away.x), KernelNumber::of(scope, away.y)];
        let seen = KernelMask::of(scope, f.visible);
        KernelNumber::sequence(terms_of(scope, f, g, blur_sigma).row(seen, away))
    })
}

/// Returns the offset of the centre from the origin, px; zero with a lens.
#[cube]
fn away(projection: &ProjectionTerms, camera: &ProjectCamera) -> Vec2 {
    let mut x = 0.0f32.runtime();
    let mut y = 0.0f32.runtime();
    if comptime!(camera.distortion.is_none()) {
        x = camera.x.focal * (projection.x.ratio - projection.x.slope);
        y = camera.y.focal * (projection.y.ratio - projection.y.slope);
    }
    Vec2::new(x, y)
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
        let at = ABSOLUTE_POS * comptime!(if camera.distortion.is_some() { LENS_COLUMNS } else { RAY_SPACE });
        let row = row_of(&projection, &gaussian, camera.blur_sigma, away(&projection, &camera));
        store_row(&row, ray_rows, at);
        #[comptime]
        if let ComptimeOption::Some(distortion) = camera.distortion {
            let (map, _jacobian) = lens_map(pose.apply(gaussian.mean), &camera, &distortion);
            let (at, seen) = (at + comptime!(RAY_SPACE), projection.visible);
            ray_rows[at] = select(seen, map.centre.x, 0.0);
            ray_rows[at + 1] = select(seen, map.centre.y, 0.0);
            ray_rows[at + 2] = select(seen, map.x.x, 0.0);
            ray_rows[at + 3] = select(seen, map.x.y, 0.0);
            ray_rows[at + 4] = select(seen, map.y.x, 0.0);
            ray_rows[at + 5] = select(seen, map.y.y, 0.0);
        }
    }
}
