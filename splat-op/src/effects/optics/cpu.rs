//! CPU twin, parallel over chunks of Gaussians of one length, whose sums are added in their order.

use fearless_simd::prelude::*;

use super::simd::{ChangeSimd, EllipseSimd};
use super::{Exposed, OpticsSpec, PARAMETERS};
use crate::project::COLUMNS;
use crate::simd::dispatch;
use crate::simd::lanes::{Columns, ROW_BLOCK, width};
use crate::simd::real::Real;
use crate::tasks;

/// Number of Gaussians per task.
const CHUNK: usize = 1024;

/// Returns the changed ellipses, `[N, 7]`.
pub(crate) fn expose_cpu<F: Real>(inputs: Exposed<&[F]>, spec: &OpticsSpec) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.projected.len()];
    let chunks = out.chunks_mut(CHUNK * COLUMNS).zip(inputs.projected.chunks(CHUNK * COLUMNS));
    tasks::for_each(chunks, |_, (out, rows)| {
        dispatch!(F, simd => change_run::<_, F>(simd, inputs.twist, spec, rows, out));
    });
    out
}

#[inline(always)]
fn change_run<S: Simd, F: Real>(simd: S, twist: &[F], spec: &OpticsSpec, rows: &[F], out: &mut [F]) {
    let change = ChangeSimd::<S, F>::new(simd, twist, spec);
    let (mut ellipses, mut changed) = (Columns::<F, COLUMNS>::new(), Columns::<F, COLUMNS>::new());
    for (rows, out) in rows.chunks(ROW_BLOCK * COLUMNS).zip(out.chunks_mut(ROW_BLOCK * COLUMNS)) {
        ellipses.read(rows);
        for at in (0..rows.len() / COLUMNS).step_by(width::<S, F>()) {
            let eight = EllipseSimd::of_row(ellipses.all_lanes(simd, at));
            for (column, value) in change.of(eight).to_row().into_iter().enumerate() {
                changed.store(column, at, value);
            }
        }
        changed.write(out);
    }
}

/// Returns the gradients of the ellipses and of the twist from `grad`, `[N, 7]`.
pub(crate) fn expose_backward_cpu<F: Real>(inputs: Exposed<&[F]>, grad: &[F], spec: &OpticsSpec) -> Exposed<Vec<F>> {
    let mut projected = vec![F::ZERO; inputs.projected.len()];
    let rows = inputs.projected.chunks(CHUNK * COLUMNS).zip(grad.chunks(CHUNK * COLUMNS));
    let sums = tasks::map(
        projected.chunks_mut(CHUNK * COLUMNS).zip(rows),
        |_, (out, (rows, grad))| dispatch!(F, simd => gradients_of_run::<_, F>(simd, inputs.twist, spec, rows, grad, out)),
    );
    let mut twist = vec![F::ZERO; inputs.twist.len()];
    for sums in sums {
        twist.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    Exposed { projected, twist }
}

/// Writes the gradients of a run of ellipses, and returns its part of those of the twist.
#[inline(always)]
fn gradients_of_run<S: Simd, F: Real>(
    simd: S,
    twist: &[F],
    spec: &OpticsSpec,
    rows: &[F],
    grad: &[F],
    out: &mut [F],
) -> [F; PARAMETERS] {
    let change = ChangeSimd::<S, F>::new(simd, twist, spec);
    let mut sums = [F::Lanes::<S>::splat(simd, F::ZERO); PARAMETERS];
    let mut found = Columns::<F, COLUMNS>::new();
    let blocks = rows.chunks(ROW_BLOCK * COLUMNS).zip(grad.chunks(ROW_BLOCK * COLUMNS));
    for ((rows, grad), out) in blocks.zip(out.chunks_mut(ROW_BLOCK * COLUMNS)) {
        // Values of a previous, longer block must not enter the sums.
        let (mut ellipses, mut of_ellipses) = (Columns::<F, COLUMNS>::new(), Columns::<F, COLUMNS>::new());
        ellipses.read(rows);
        of_ellipses.read(grad);
        for at in (0..rows.len() / COLUMNS).step_by(width::<S, F>()) {
            let eight = EllipseSimd::of_row(ellipses.all_lanes(simd, at));
            let of_eight = EllipseSimd::of_row(of_ellipses.all_lanes(simd, at));
            let gradient = change.backward(&eight, &of_eight, &mut sums);
            for (column, value) in gradient.to_row().into_iter().enumerate() {
                found.store(column, at, value);
            }
        }
        found.write(out);
    }
    let mut total = [F::ZERO; PARAMETERS];
    for (total, sum) in total.iter_mut().zip(sums) {
        *total = sum.reduce_sum();
    }
    total
}
