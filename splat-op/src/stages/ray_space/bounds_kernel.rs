//! Kernel of the bounds: one unit per Gaussian.

use cubecl::prelude::*;

use super::bounds::BoundsRules;
use super::lens_bounds::LensLimits;
use super::{LENS_COLUMNS, RAY_SPACE};
use crate::camera::{Intrinsics, PictureRays};
use crate::gpu::{KernelNumber, Vec2, Vec2Launch, load_row, store_row};
use crate::project::{COLUMNS, Ellipse};

/// Limits of a lens as an argument.
#[allow(dead_code, reason = "kernels read the fields of the expanded type")]
#[derive(CubeType, CubeLaunch, Clone, Copy)]
pub(super) struct LensLimitsArg {
    low: Vec2,
    high: Vec2,
    farthest: f32,
    bend_px: f32,
    bend_radius: f32,
    stretch_px: f32,
    #[cube(comptime)]
    fisheye: bool,
}

/// Returns the limits of a lens; `None` for a pinhole.
pub(super) fn lens_limits(camera: &Intrinsics) -> Option<LensLimitsArgLaunch> {
    let rays = PictureRays::of(camera)?;
    let limits = LensLimits::<f32>::new(camera, &rays);
    let both = |[x, y]: [f32; 2]| Vec2Launch::new(x, y);
    Some(LensLimitsArgLaunch::new(
        both(limits.low),
        both(limits.high),
        limits.farthest,
        limits.bend_px.min(f32::MAX),
        limits.bend_radius,
        limits.stretch_px.min(f32::MAX),
        limits.fisheye,
    ))
}

/// Returns the bounds of a Gaussian, from its packed ellipse, its row in ray space and the picture's size.
#[cube]
fn bounds_of(
    ellipse: &Sequence<f32>,
    row: &Sequence<f32>,
    size: Vec2,
    alpha_min: f32,
    lens: &ComptimeOption<LensLimitsArg>,
) -> Sequence<f32> {
    intrinsic!(|scope| {
        let n = |value| KernelNumber::of(scope, value);
        let limits = match lens {
            ComptimeOptionExpand::Some(lens) => Some(LensLimits {
                fisheye: lens.fisheye,
                low: [n(lens.low.x), n(lens.low.y)],
                high: [n(lens.high.x), n(lens.high.y)],
                farthest: n(lens.farthest),
                bend_px: n(lens.bend_px),
                bend_radius: n(lens.bend_radius),
                stretch_px: n(lens.stretch_px),
            }),
            ComptimeOptionExpand::None => None,
        };
        let rules = BoundsRules { size: [n(size.x), n(size.y)], alpha_min: n(alpha_min), limits };
        let given = Ellipse::from_row(&KernelNumber::row(scope, ellipse));
        KernelNumber::sequence(rules.bound(&given, &KernelNumber::row(scope, row)).to_row())
    })
}

/// Writes the bounds, `[N, 7]`.
#[cube(launch_unchecked)]
pub(super) fn bounds_kernel(
    projected: &[f32],
    ray_rows: &[f32],
    bounds: &mut [f32],
    size: Vec2,
    alpha_min: f32,
    lens: ComptimeOption<LensLimitsArg>,
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let columns = comptime!(if lens.is_some() { LENS_COLUMNS } else { RAY_SPACE });
        let ellipse = load_row(projected, ABSOLUTE_POS * comptime!(COLUMNS), COLUMNS);
        let row = load_row(ray_rows, ABSOLUTE_POS * columns, columns);
        store_row(&bounds_of(&ellipse, &row, size, alpha_min, &lens), bounds, ABSOLUTE_POS * comptime!(COLUMNS));
    }
}
