//! Kernels of the changes of ellipses: one unit per Gaussian. The backward kernel computes the change again and differentiates it. The
//! gradient of the twist is added over a cube, and its row over the cubes by another kernel.

use cubecl::prelude::*;

use super::formulas::Change;
use super::{OpticsEffect, PARAMETERS};
use crate::gpu::{KernelNumber, UNITS, cube_sum, load_row, store_row};
use crate::project::axis::CameraAxis;
use crate::project::{COLUMNS, Ellipse};

/// Camera and change as arguments of the kernels.
#[allow(dead_code, reason = "kernels read the fields of the expanded type")]
#[derive(CubeType, CubeLaunch, Clone, Copy)]
pub(super) struct ChangeArg {
    /// Their limits are those to which a centre is clamped for its velocity, px.
    x: CameraAxis,
    y: CameraAxis,
    /// px.
    height: f32,
    #[cube(comptime)]
    exposure: OpticsEffect,
}

impl ChangeArgExpand {
    /// The change as numbers.
    fn numbers<'a>(&self, scope: &'a Scope, twist: &SequenceExpand<f32>) -> Change<KernelNumber<'a>> {
        let n = |value| KernelNumber::of(scope, value);
        let twist = KernelNumber::row(scope, twist);
        Change {
            exposure: self.exposure,
            axes: [self.x, self.y].map(|axis| [n(axis.focal), n(axis.principal), n(axis.low), n(axis.high)]),
            height: n(self.height),
            twist: std::array::from_fn(|i| twist[i]),
        }
    }
}

#[cube]
fn changed(change: &ChangeArg, twist: &Sequence<f32>, ellipse: &Sequence<f32>) -> Sequence<f32> {
    intrinsic!(|scope| {
        let e = Ellipse::from_row(&KernelNumber::row(scope, ellipse));
        KernelNumber::sequence(change.numbers(scope, twist).of(&e).to_row())
    })
}

/// Returns the gradients of the ellipse and of the twist.
#[cube]
fn change_backward(
    change: &ChangeArg,
    twist: &Sequence<f32>,
    ellipse: &Sequence<f32>,
    grad: &Sequence<f32>,
) -> (Sequence<f32>, Sequence<f32>) {
    intrinsic!(|scope| {
        let [e, grad] = [ellipse, grad].map(|row| Ellipse::from_row(&KernelNumber::row(scope, row)));
        let (of_ellipse, of_twist) = change.numbers(scope, twist).backward(&e, &grad);
        (KernelNumber::sequence(of_ellipse.to_row()), KernelNumber::sequence(of_twist))
    })
}

#[cube(launch_unchecked)]
pub(super) fn expose_kernel(projected: &[f32], twist: &[f32], out: &mut [f32], change: ChangeArg, count: u32) {
    if ABSOLUTE_POS < count as usize {
        let at = ABSOLUTE_POS * comptime!(COLUMNS);
        let ellipse = load_row(projected, at, COLUMNS);
        if ellipse[5] == 0.0 {
            store_row(&ellipse, out, at);
        } else {
            store_row(&changed(&change, &load_row(twist, 0, PARAMETERS), &ellipse), out, at);
        }
    }
}

/// Writes the gradients of the ellipses, `[N, 7]`, and one row per cube of that of the twist, `[cubes, 6]`.
#[cube(launch_unchecked)]
pub(super) fn expose_backward_kernel(
    projected: &[f32],
    twist: &[f32],
    grad: &[f32],
    of_projected: &mut [f32],
    rows: &mut [f32],
    change: ChangeArg,
    count: u32,
) {
    let mut of_twist = Array::<f32>::new(comptime!(PARAMETERS));
    #[unroll]
    for i in 0..comptime!(PARAMETERS) {
        of_twist[i] = 0.0;
    }
    if ABSOLUTE_POS < count as usize {
        let at = ABSOLUTE_POS * comptime!(COLUMNS);
        let (ellipse, grad) = (load_row(projected, at, COLUMNS), load_row(grad, at, COLUMNS));
        if ellipse[5] == 0.0 {
            store_row(&grad, of_projected, at);
        } else {
            let (of, found) = change_backward(&change, &load_row(twist, 0, PARAMETERS), &ellipse, &grad);
            store_row(&of, of_projected, at);
            #[unroll]
            for i in 0..comptime!(PARAMETERS) {
                of_twist[i] = found[i];
            }
        }
    }
    // A dispatch may hold more cubes than there are rows.
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS * comptime!(UNITS) < count as usize {
        #[unroll]
        for i in 0..comptime!(PARAMETERS) {
            let sum = cube_sum(of_twist[i], &mut shared);
            if UNIT_POS == 0 {
                rows[CUBE_POS * comptime!(PARAMETERS) + i] = sum;
            }
        }
    }
}
