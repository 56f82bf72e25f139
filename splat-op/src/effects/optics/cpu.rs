//! CPU twin, parallel over chunks of Gaussians of one length, whose sums are added in their order.

use fearless_simd::prelude::*;

use super::formulas::Change;
use super::{Exposed, OpticsSpec, PARAMETERS};
use crate::linalg::Number;
use crate::project::{COLUMNS, Ellipse};
use crate::simd::{Columns, LaneNumber, MaskOf, ROW_BLOCK, Real, dispatch, each, width};
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
fn change_of<S: Simd, F: Real>(simd: S, twist: &[F], spec: &OpticsSpec) -> Change<LaneNumber<S, F>> {
    let lanes = |value: f64| LaneNumber::splat(simd, F::of(value));
    Change {
        exposure: spec.exposure,
        axes: each!(spec.axes(), |axis| each!(axis, |value| lanes(value))),
        height: lanes(spec.intrinsics.height as f64),
        twist: each!([0, 1, 2, 3, 4, 5], |i| LaneNumber::splat(simd, twist[i])),
    }
}

#[inline(always)]
fn change_run<S: Simd, F: Real>(simd: S, twist: &[F], spec: &OpticsSpec, rows: &[F], out: &mut [F]) {
    let change = change_of(simd, twist, spec);
    let (mut ellipses, mut changed) = (Columns::<F, COLUMNS>::new(), Columns::<F, COLUMNS>::new());
    for (rows, out) in rows.chunks(ROW_BLOCK * COLUMNS).zip(out.chunks_mut(ROW_BLOCK * COLUMNS)) {
        ellipses.read(rows);
        for at in (0..rows.len() / COLUMNS).step_by(width::<S, F>()) {
            let row = ellipses.numbers(simd, at);
            let found = change.of(&Ellipse::from_row(&row)).to_row();
            let kept = LaneNumber::select_all(culled(&row), row, found);
            changed.store(at, LaneNumber::lanes(kept));
        }
        changed.write(out);
    }
}

/// Whether Gaussians are culled: their depth is zero.
#[inline(always)]
fn culled<S: Simd, F: Real>(row: &[LaneNumber<S, F>; COLUMNS]) -> MaskOf<S, F> {
    row[5].eq(row[5].constant(0.0))
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
    let change = change_of(simd, twist, spec);
    let zero = F::Lanes::<S>::splat(simd, F::ZERO);
    let mut sums = [zero; PARAMETERS];
    let mut found = Columns::<F, COLUMNS>::new();
    let blocks = rows.chunks(ROW_BLOCK * COLUMNS).zip(grad.chunks(ROW_BLOCK * COLUMNS));
    for ((rows, grad), out) in blocks.zip(out.chunks_mut(ROW_BLOCK * COLUMNS)) {
        // Values of a previous, longer block must not enter the sums.
        let (mut ellipses, mut of_ellipses) = (Columns::<F, COLUMNS>::new(), Columns::<F, COLUMNS>::new());
        ellipses.read(rows);
        of_ellipses.read(grad);
        for at in (0..rows.len() / COLUMNS).step_by(width::<S, F>()) {
            let (row, grad) = (ellipses.numbers(simd, at), of_ellipses.numbers(simd, at));
            let (of_ellipse, of_twist) = change.backward(&Ellipse::from_row(&row), &Ellipse::from_row(&grad));
            let culled = culled(&row);
            let kept = LaneNumber::select_all(culled, grad, of_ellipse.to_row());
            found.store(at, LaneNumber::lanes(kept));
            for (sum, value) in sums.iter_mut().zip(of_twist) {
                *sum += culled.select(zero, value.0);
            }
        }
        found.write(out);
    }
    each!(sums, |sum| sum.reduce_sum())
}
