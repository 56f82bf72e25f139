//! Kernel of both stages, forward: one unit per Gaussian.

use cubecl::prelude::*;

use crate::gpu::math::{Pose, Vec3};
use crate::project::forward::{Gaussian, Lens, Packed, packed_of, project_one};
use crate::shade::Harmonics;
use crate::shade::forward::colour_of;

/// Whether the Gaussian may show in the picture; see [`super`]. An opacity above one, which the op does not forbid, reaches
/// further than the box.
#[cube]
fn may_show(ellipse: &Packed, sigmas: f32, width: f32, height: f32) -> bool {
    let half_x = sigmas * ellipse.sigma_u + 1.0;
    let half_y = sigmas * (ellipse.sigma_v + ellipse.shear.abs() * ellipse.sigma_u) + 1.0;
    let beside = ellipse.x + half_x >= 0.0 && ellipse.x - half_x <= width;
    let level = ellipse.y + half_y >= 0.0 && ellipse.y - half_y <= height;
    ellipse.opacity > 1.0 || (ellipse.opacity > 0.0 && beside && level)
}

#[cube(launch_unchecked)]
pub(super) fn project_shade_forward_kernel(
    means: &[f32],
    rotations: &[f32],
    scales: &[f32],
    opacities: &[f32],
    sh: &[f32],
    matte: ComptimeOption<Box<[f32]>>,
    first_matte: ComptimeOption<u32>,
    cam_from_world: &[f32],
    projected: &mut [f32],
    colours: &mut [f32],
    lens: Lens,
    sigmas: f32,
    width: f32,
    height: f32,
    count: u32,
    #[comptime] harmonics: Harmonics,
) {
    if ABSOLUTE_POS < count as usize {
        let gaussian = Gaussian::load(means, rotations, scales, opacities, ABSOLUTE_POS);
        let pose = Pose::load(cam_from_world);
        let packed = packed_of(&gaussian, &project_one(&gaussian, &pose, &lens), &lens);
        packed.store(projected, ABSOLUTE_POS);
        let mut colour = Vec3::new(0.0, 0.0, 0.0);
        if may_show(&packed, sigmas, width, height) {
            #[comptime]
            match first_matte {
                ComptimeOption::Some(first) => {
                    let first = first as usize;
                    if ABSOLUTE_POS < first {
                        colour = colour_of(sh, ABSOLUTE_POS, gaussian.mean, pose, harmonics);
                    } else {
                        let (row, of) = (ABSOLUTE_POS - first, comptime!(harmonics.constant()));
                        colour = colour_of(&matte.unwrap(), row, gaussian.mean, pose, of);
                    }
                }
                ComptimeOption::None => {
                    colour = colour_of(sh, ABSOLUTE_POS, gaussian.mean, pose, harmonics);
                }
            }
        }
        colour.store(colours, 3 * ABSOLUTE_POS);
    }
}
