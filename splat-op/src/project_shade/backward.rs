//! Kernel of both stages, backward: one unit per Gaussian. Outputs that nobody asked for are not arguments, and what only
//! they need is not in the kernel.

use cubecl::prelude::*;

use crate::gpu::math::{Pose, Vec3};
use crate::project::backward::{Wanted, any, gaussian_backward, no_gradient};
use crate::project::forward::{Gaussian, Lens, Packed};
use crate::shade::Harmonics;
use crate::shade::backward::{any_colour, colour_backward, no_harmonics};

/// Stores the gradient of the harmonics in row `row` of `sh`, if it is asked for, and returns that of the vector from the camera
/// to the Gaussian's centre, or zero unless `means_wanted`.
#[cube]
fn of_colour(
    sh: &[f32],
    row: usize,
    means: &[f32],
    gaussian: usize,
    pose: Pose,
    grad: Vec3,
    grad_sh: &mut ComptimeOption<Box<[f32]>>,
    #[comptime] harmonics: Harmonics,
    #[comptime] means_wanted: bool,
) -> Vec3 {
    let mut of_sight = Vec3::new(0.0, 0.0, 0.0);
    if any_colour(grad) {
        let through_direction = comptime!(harmonics.degree > 0 && means_wanted);
        let mean = Vec3::load(means, 3 * gaussian);
        of_sight = colour_backward(sh, row, mean, pose, grad, grad_sh, harmonics, through_direction);
    } else {
        no_harmonics(row, grad_sh, comptime!(harmonics.degree));
    }
    of_sight
}

#[cube(launch_unchecked)]
pub(super) fn project_shade_backward_kernel(
    means: &[f32],
    rotations: &[f32],
    scales: &[f32],
    opacities: &[f32],
    sh: &[f32],
    matte: ComptimeOption<Box<[f32]>>,
    first_matte: ComptimeOption<u32>,
    cam_from_world: &[f32],
    grad_packed: &[f32],
    grad_colours: &[f32],
    grad_means: ComptimeOption<&mut [f32]>,
    grad_rotations: ComptimeOption<&mut [f32]>,
    grad_scales: ComptimeOption<&mut [f32]>,
    grad_opacities: ComptimeOption<&mut [f32]>,
    grad_mean2d: ComptimeOption<&mut [f32]>,
    mut grad_sh: ComptimeOption<Box<[f32]>>,
    mut grad_matte: ComptimeOption<Box<[f32]>>,
    lens: Lens,
    count: u32,
    #[comptime] harmonics: Harmonics,
) {
    let wanted = comptime!(Wanted {
        means: grad_means.is_some(),
        rotations: grad_rotations.is_some(),
        scales: grad_scales.is_some(),
        pose: false,
    });
    let gaussian = ABSOLUTE_POS;
    if gaussian < count as usize {
        let pose = Pose::load(cam_from_world);
        let mut of = no_gradient();
        let grad = Packed::load(grad_packed, gaussian);
        if any(&grad) {
            let g = Gaussian::load(means, rotations, scales, opacities, gaussian);
            of = gaussian_backward(&g, &pose, &lens, &grad, wanted);
        }
        let mut of_sight = Vec3::new(0.0, 0.0, 0.0);
        let grad = Vec3::load(grad_colours, 3 * gaussian);
        #[comptime]
        match first_matte {
            ComptimeOption::Some(first) => {
                let first = first as usize;
                if gaussian < first {
                    of_sight =
                        of_colour(sh, gaussian, means, gaussian, pose, grad, &mut grad_sh, harmonics, wanted.means);
                } else {
                    let row = gaussian - first;
                    let matte = matte.unwrap();
                    // Of degree 0, whose colours do not depend on the direction.
                    let constant = comptime!(harmonics.constant());
                    of_colour(&matte, row, means, gaussian, pose, grad, &mut grad_matte, constant, false);
                }
            }
            ComptimeOption::None => {
                // As `of_colour`, which as a call would leave another text of the plain kernel.
                if any_colour(grad) {
                    let through_direction = comptime!(harmonics.degree > 0 && wanted.means);
                    let mean = Vec3::load(means, 3 * gaussian);
                    of_sight =
                        colour_backward(sh, gaussian, mean, pose, grad, &mut grad_sh, harmonics, through_direction);
                } else {
                    no_harmonics(gaussian, &mut grad_sh, comptime!(harmonics.degree));
                }
            }
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_means {
            of.mean.plus(of_sight).store(out, 3 * gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_rotations {
            of.rotation.store(out, 4 * gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_scales {
            of.scale.store(out, 3 * gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_opacities {
            out[gaussian] = of.opacity;
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_mean2d {
            out[2 * gaussian] = of.mean2d_x;
            out[2 * gaussian + 1] = of.mean2d_y;
        }
    }
}
