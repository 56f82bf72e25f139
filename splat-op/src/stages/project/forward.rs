//! Kernel of `project`, forward: one unit per Gaussian. The projection of one Gaussian is a separate function, because the
//! backward kernel recomputes it instead of reading stored values.

use cubecl::prelude::*;

use super::axis::{CameraAxis, JacobianRow};
use super::lens_kernel::{DistortionArg, bent_rows};
use super::{COLUMNS, COMPENSATION_MIN};
use crate::gpu::{Mat3, Pose, Quaternion, Vec3, finite};

/// Camera and options as arguments of the kernels.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct ProjectCamera {
    pub x: CameraAxis,
    pub y: CameraAxis,
    /// Near and far plane, camera z, scene units.
    pub near: f32,
    pub far: f32,
    /// Standard deviation up to which splats are culled, if `clips` is set, px.
    pub clip_sigma: f32,
    /// Square root of the blur, px.
    pub blur_sigma: f32,
    /// Lens; absent for a pinhole.
    pub distortion: ComptimeOption<DistortionArg>,
    #[cube(comptime)]
    pub antialias: bool,
    #[cube(comptime)]
    pub clips: bool,
    /// Whether Gaussians have factors of covariances.
    #[cube(comptime)]
    pub factors: bool,
}

/// What the kernels read of Gaussians, and the pose of the camera.
#[derive(CubeType, CubeLaunch)]
pub(crate) struct GeometryInputs {
    means: Box<[f32]>,
    rotations: Box<[Vector<f32, Const<4>>]>,
    scales: Box<[f32]>,
    opacities: Box<[f32]>,
    cam_from_world: Box<[f32]>,
}

#[cube]
impl GeometryInputs {
    pub fn gaussian(&self, at: usize) -> Gaussian {
        Gaussian {
            mean: Vec3::load(&self.means, 3 * at),
            rotation: Quaternion::load(&self.rotations, at),
            scale: Vec3::load(&self.scales, 3 * at),
            opacity: self.opacities[at],
        }
    }

    pub fn pose(&self) -> Pose {
        Pose::load(&self.cam_from_world)
    }
}

/// One Gaussian's parameters.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct Gaussian {
    pub mean: Vec3,
    pub rotation: Quaternion,
    pub scale: Vec3,
    pub opacity: f32,
}

#[cube]
impl Gaussian {
    /// The matrix in place of `R`, of which `unit` is the quaternion.
    fn world_from_gaussian(&self, unit: &Quaternion, #[comptime] factors: bool) -> Mat3 {
        if comptime!(factors) {
            let (q, zero) = (self.rotation, 0.0f32.runtime());
            Mat3 {
                x: Vec3::new(q.w, zero, zero),
                y: Vec3::new(q.x, q.y, zero),
                z: Vec3::new(q.z, self.scale.x, self.scale.y),
            }
        } else {
            unit.matrix()
        }
    }

    /// The numbers in place of the scales.
    pub fn sizes(&self, #[comptime] factors: bool) -> Vec3 {
        if comptime!(factors) { Vec3::new(1.0, 1.0, 1.0) } else { self.scale }
    }

    fn finite(&self) -> bool {
        let (m, q, s) = (self.mean, self.rotation, self.scale);
        let mean = finite(m.x) && finite(m.y) && finite(m.z);
        let rotation = finite(q.w) && finite(q.x) && finite(q.y) && finite(q.z);
        mean && rotation && finite(s.x) && finite(s.y) && finite(s.z) && finite(self.opacity)
    }
}

/// Row of the packed output or of its gradient.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct PackedEllipse {
    pub x: f32,
    pub y: f32,
    pub sigma_u: f32,
    pub shear: f32,
    pub sigma_v: f32,
    pub depth: f32,
    pub opacity: f32,
}

#[cube]
impl PackedEllipse {
    pub fn load(from: &[f32], gaussian: usize) -> PackedEllipse {
        let at = gaussian * comptime!(COLUMNS);
        PackedEllipse {
            x: from[at],
            y: from[at + 1],
            sigma_u: from[at + 2],
            shear: from[at + 3],
            sigma_v: from[at + 4],
            depth: from[at + 5],
            opacity: from[at + 6],
        }
    }

    pub fn store(&self, to: &mut [f32], gaussian: usize) {
        let at = gaussian * comptime!(COLUMNS);
        to[at] = self.x;
        to[at + 1] = self.y;
        to[at + 2] = self.sigma_u;
        to[at + 3] = self.shear;
        to[at + 4] = self.sigma_v;
        to[at + 5] = self.depth;
        to[at + 6] = self.opacity;
    }
}

/// Intermediate values of the forward pass that the backward pass needs. The names are those of the equations of [`project`](super).
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct ProjectionTerms {
    /// Whether the Gaussian is not culled. If it is, all other fields are meaningless.
    pub visible: bool,
    pub mean_cam: Vec3,
    pub quaternion: Quaternion,
    pub quaternion_length: f32,
    pub world_from_gaussian: Mat3,
    /// `W R`.
    pub cam_from_gaussian: Mat3,
    pub x: JacobianRow,
    pub y: JacobianRow,
    /// `m0 / sigma_u`, `m1 / sigma_u`, `n × m1` and its length.
    pub n: Vec3,
    pub along: Vec3,
    pub p: Vec3,
    pub p_length: f32,
    pub sigma_u: f32,
    pub shear: f32,
    pub sigma_v: f32,
    /// Factor of the opacity, and whether it is free (not at its lower limit, and with anti-aliasing).
    pub compensation: f32,
    pub compensation_free: bool,
}

/// Projections along both axes, from the centre in the camera's frame and `W R`, and whether the centre lies within the domain of a lens.
#[cube]
fn seen_rows(
    mean_cam: Vec3,
    cam_from_gaussian: Mat3,
    scale: Vec3,
    camera: &ProjectCamera,
) -> (JacobianRow, JacobianRow, bool) {
    #[comptime]
    match camera.distortion {
        ComptimeOption::Some(distortion) => {
            bent_rows(mean_cam, cam_from_gaussian, scale, &camera.x, &camera.y, &distortion)
        }
        ComptimeOption::None => {
            let (depth, last) = (mean_cam.z, cam_from_gaussian.z);
            let x = camera.x.project(mean_cam.x, depth, cam_from_gaussian.x, last, scale);
            let y = camera.y.project(mean_cam.y, depth, cam_from_gaussian.y, last, scale);
            (x, y, true)
        }
    }
}

#[cube]
pub(crate) fn project_one(gaussian: &Gaussian, pose: &Pose, camera: &ProjectCamera) -> ProjectionTerms {
    let mean_cam = pose.apply(gaussian.mean);
    let (quaternion, quaternion_length) = gaussian.rotation.unit();
    let world_from_gaussian = gaussian.world_from_gaussian(&quaternion, comptime!(camera.factors));
    let cam_from_gaussian = pose.matrix.times(world_from_gaussian);
    let (depth, scale) = (mean_cam.z, gaussian.sizes(comptime!(camera.factors)));
    let (x, y, within) = seen_rows(mean_cam, cam_from_gaussian, scale, camera);

    let sigma_u = Vec3::new(x.m.length(), camera.blur_sigma, 0.0).length();
    let inverse = 1.0 / sigma_u;
    let n = x.m.times(inverse);
    let along = y.m.times(inverse);
    let p = n.cross(y.m);
    let p_length = p.length();
    let sigma_v = Vec3::new(p_length, camera.blur_sigma, camera.blur_sigma * along.length()).length();
    let shear = n.dot(along);

    let between = depth > camera.near && depth > 0.0 && depth < camera.far;
    let in_front = between && finite(depth) && finite(x.ratio) && finite(y.ratio);
    let mut wide = sigma_u > 0.0 && finite(sigma_u) && sigma_v > 0.0 && finite(sigma_v) && finite(shear);
    if comptime!(camera.clips) {
        let vertical = Vec3::new(shear * sigma_u, sigma_v, 0.0).length();
        wide = wide && (sigma_u > camera.clip_sigma || vertical > camera.clip_sigma);
    }
    let drawn = gaussian.finite() && in_front && quaternion_length > 0.0 && wide;
    let visible = if comptime!(camera.distortion.is_some()) { drawn && within } else { drawn };

    let mut compensation = 1.0f32;
    let mut compensation_free = false;
    if comptime!(camera.antialias) {
        let floor = comptime!(COMPENSATION_MIN as f32);
        let areas = p_length / sigma_v;
        compensation = max(areas, floor);
        compensation_free = areas > floor;
    }
    ProjectionTerms {
        visible,
        mean_cam,
        quaternion,
        quaternion_length,
        world_from_gaussian,
        cam_from_gaussian,
        x,
        y,
        n,
        along,
        p,
        p_length,
        sigma_u,
        shear,
        sigma_v,
        compensation,
        compensation_free,
    }
}

/// Row of a Gaussian; that of a culled one is zero except `sigma_u = sigma_v = 1`.
#[cube]
pub(crate) fn packed_of(gaussian: &Gaussian, p: &ProjectionTerms, camera: &ProjectCamera) -> PackedEllipse {
    PackedEllipse {
        x: select(p.visible, camera.x.focal * p.x.ratio + camera.x.principal, 0.0),
        y: select(p.visible, camera.y.focal * p.y.ratio + camera.y.principal, 0.0),
        sigma_u: select(p.visible, p.sigma_u, 1.0),
        shear: select(p.visible, p.shear, 0.0),
        sigma_v: select(p.visible, p.sigma_v, 1.0),
        depth: select(p.visible, p.mean_cam.z, 0.0),
        opacity: select(p.visible, gaussian.opacity * p.compensation, 0.0),
    }
}

#[cube(launch_unchecked)]
pub(super) fn project_forward_kernel(inputs: GeometryInputs, projected: &mut [f32], camera: ProjectCamera, count: u32) {
    if ABSOLUTE_POS < count as usize {
        let gaussian = inputs.gaussian(ABSOLUTE_POS);
        let p = project_one(&gaussian, &inputs.pose(), &camera);
        packed_of(&gaussian, &p, &camera).store(projected, ABSOLUTE_POS);
    }
}
