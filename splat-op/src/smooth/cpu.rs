//! CPU twin of the convolution, parallel over runs of Gaussians.

use rayon::prelude::*;

use super::Smooth;
use crate::linalg::norm;
use crate::simd::real::Real;

/// Number of Gaussians per task.
const RUN: usize = 2048;

/// `[N, 3]`: the new standard deviations.
pub(crate) fn smoothed_scales_cpu<F: Real>(scales: &[F], widths: &[F]) -> Vec<F> {
    let mut out = vec![F::ZERO; scales.len()];
    out.par_chunks_mut(3 * RUN).zip(scales.par_chunks(3 * RUN).zip(widths.par_chunks(RUN))).for_each(
        |(out, (scales, widths))| {
            let rows = scales.as_chunks::<3>().0.iter().zip(widths);
            for (out, (scales, &width)) in out.as_chunks_mut::<3>().0.iter_mut().zip(rows) {
                *out = scales.map(|scale| norm([scale, width, F::ZERO]));
            }
        },
    );
    out
}

/// Inverses of the new standard deviations, and the shares of the old ones in them.
fn shares<F: Real>(scales: &[F; 3], width: F) -> ([F; 3], [F; 3]) {
    let inverse = scales.map(|scale| F::ONE / norm([scale, width, F::ZERO]));
    (inverse, std::array::from_fn(|axis| scales[axis] * inverse[axis]))
}

/// `[N]`: the new opacities.
pub(crate) fn smoothed_opacities_cpu<F: Real>(inputs: Smooth<&[F]>) -> Vec<F> {
    let rows = inputs.scales.as_chunks::<3>().0.par_iter().zip(inputs.widths).zip(inputs.opacities);
    let of = |((scales, &width), &opacity): ((&[F; 3], &F), &F)| {
        let [x, y, z] = shares(scales, width).1;
        opacity * (x * y * z)
    };
    rows.with_min_len(RUN).map(of).collect()
}

/// Returns the gradients of the standard deviations and of the opacities from `grad`, `[N]`, that of the new opacities.
pub(crate) fn smoothed_opacities_backward_cpu<F: Real>(inputs: Smooth<&[F]>, grad: &[F]) -> Smooth<Vec<F>> {
    let rows = inputs.scales.as_chunks::<3>().0.par_iter().zip(inputs.widths).zip(inputs.opacities).zip(grad);
    let of = |(((scales, &width), &opacity), &grad): (((&[F; 3], &F), &F), &F)| {
        let (inverse, [x, y, z]) = shares(scales, width);
        let others = [y * z, x * z, x * y];
        let of_scale = |axis: usize| {
            let added = width * inverse[axis];
            grad * opacity * others[axis] * (added * added * inverse[axis])
        };
        ([of_scale(0), of_scale(1), of_scale(2)], grad * (x * y * z))
    };
    let (scales, opacities): (Vec<[F; 3]>, Vec<F>) = rows.with_min_len(RUN).map(of).unzip();
    Smooth { scales: scales.into_flattened(), opacities, widths: Vec::new() }
}
