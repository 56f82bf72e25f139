//! Last step of the CPU twin's backward pass: rows of sums to gradients.

use super::prepared::CHUNK;
use super::{Layers, MOMENTS};
use crate::intersect::IntersectionLists;
use crate::project::{COLUMNS, Ellipse, OPACITY};
use crate::ray_space::{SHAPE, SLOPES};
use crate::simd::real::Real;
use crate::tasks;

/// Sums over each tile, a row per intersection: the moments, the channels (depth is the last), along rays the gradient of the depth
/// slope and of the centre's relative depth, and in the last two columns the sums of absolute values if they are wanted.
pub(super) struct RowSums<'a, F> {
    pub rows: &'a [F],
    pub columns: usize,
    pub channels: usize,
    /// The inverse of the factor in `u` and `v`.
    pub unscale: f64,
}

/// Adds the sums of each Gaussian's intersections in order and turns them into gradients of its ellipse and `features`
/// features. With `ray_columns` above zero the Gaussian was seen along rays: the gradient of its shape goes to its row of `ray_space`,
/// which has as many columns, and the ellipse keeps that of its opacity.
pub(super) fn gather<F: Real>(
    ellipses: &[F],
    features: usize,
    intersections: &IntersectionLists,
    sums: &RowSums<F>,
    needs: Layers<bool>,
    ray_columns: usize,
) -> Layers<Vec<F>> {
    let RowSums { rows, columns, channels, unscale } = *sums;
    let (count, lists) = (ellipses.len() / COLUMNS, intersections);
    let zeros = |needed: bool, columns: usize| vec![F::ZERO; if needed { count * columns } else { 0 }];
    let mut grads = Layers {
        projected: zeros(needs.projected, COLUMNS),
        features: zeros(needs.features, features),
        background: Vec::new(),
        mean2d_abs: zeros(needs.mean2d_abs, 2),
        ray_space: zeros(needs.ray_space, ray_columns),
    };
    let of_ellipses = chunks(&mut grads.projected, COLUMNS, count).into_iter();
    let of_features = chunks(&mut grads.features, features, count);
    let others =
        chunks(&mut grads.mean2d_abs, 2, count).into_iter().zip(chunks(&mut grads.ray_space, ray_columns, count));
    let parts = of_ellipses.zip(of_features).zip(others);
    tasks::for_each(parts, |chunk, ((projected, feature), (absolute, ray))| {
        let mut sum = vec![F::ZERO; columns];
        let first = chunk * CHUNK;
        let place = |gaussian: usize| lists.visible.partition_point(|&visible| (visible as usize) < gaussian);
        for place in place(first)..place(first + CHUNK) {
            let i = lists.visible[place] as usize - first;
            let range = lists.visible_start[place] as usize..lists.visible_start[place + 1] as usize;
            let own = &lists.intersection_of_visible[range];
            sum.fill(F::ZERO);
            match columns {
                RGB_COLUMNS => add_rows_of::<F, RGB_COLUMNS>(rows, own, &mut sum),
                RGBD_COLUMNS => add_rows_of::<F, RGBD_COLUMNS>(rows, own, &mut sum),
                RAY_RGB_COLUMNS => add_rows_of::<F, RAY_RGB_COLUMNS>(rows, own, &mut sum),
                _ => add_rows(rows, own, &mut sum),
            }
            let (moments, colours) = sum.split_at(MOMENTS);
            if needs.projected || needs.ray_space {
                let ellipse = Ellipse::from_row(&ellipses[(first + i) * COLUMNS..]);
                let depth = if channels > features { colours[features] } else { F::ZERO };
                let mut grad = ellipse_gradient(&ellipse, moments, depth, unscale).to_row();
                if needs.ray_space {
                    let ray = &mut ray[i * ray_columns..][..ray_columns];
                    ray[..SLOPES].copy_from_slice(&colours[channels..channels + SLOPES]);
                    ray[SLOPES..SLOPES + SHAPE].copy_from_slice(&grad[..SHAPE]);
                }
                if ray_columns > 0 {
                    grad[..OPACITY].fill(F::ZERO);
                }
                if needs.projected {
                    projected[i * COLUMNS..(i + 1) * COLUMNS].copy_from_slice(&grad);
                }
            }
            if needs.features {
                feature[i * features..(i + 1) * features].copy_from_slice(&colours[..features]);
            }
            if needs.mean2d_abs {
                // Two factors are scaled: a whitened coordinate and an inverse.
                let unscaled = F::of(unscale * unscale);
                let sums = absolute[2 * i..2 * i + 2].iter_mut().zip(&sum[columns - 2..]);
                sums.for_each(|(out, sum)| *out = *sum * unscaled);
            }
        }
    });
    grads
}

/// Splits a gradient by chunks of Gaussians; a gradient that is not wanted has empty parts.
fn chunks<F>(grad: &mut [F], columns: usize, count: usize) -> Vec<&mut [F]> {
    let mut parts: Vec<&mut [F]> = grad.chunks_mut(CHUNK * columns.max(1)).collect();
    parts.resize_with(count.div_ceil(CHUNK), Default::default);
    parts
}

/// Number of columns of the sums for three channels.
const RGB_COLUMNS: usize = MOMENTS + 3;

/// Number of columns of the sums for three channels and depth.
const RGBD_COLUMNS: usize = RGB_COLUMNS + 1;

/// Number of columns of the sums for three channels along rays.
const RAY_RGB_COLUMNS: usize = RGB_COLUMNS + SLOPES;

/// Adds rows of `intersection_sums` to `sum`.
#[inline(always)]
fn add_rows<F: Real>(intersection_sums: &[F], rows: &[u32], sum: &mut [F]) {
    let columns = sum.len();
    for &row in rows {
        let row = &intersection_sums[row as usize * columns..(row as usize + 1) * columns];
        sum.iter_mut().zip(row).for_each(|(sum, &value)| *sum += value);
    }
}

/// [`add_rows`] for a length known at compile time: the fewer instructions a row takes, the more rows are fetched at a time.
#[inline(always)]
fn add_rows_of<F: Real, const COLUMNS: usize>(intersection_sums: &[F], rows: &[u32], sum: &mut [F]) {
    let table = intersection_sums.as_chunks::<COLUMNS>().0;
    let mut total = [F::ZERO; COLUMNS];
    for &row in rows {
        total.iter_mut().zip(&table[row as usize]).for_each(|(sum, &value)| *sum += value);
    }
    sum.copy_from_slice(&total);
}

/// Turns the sums of `h, h u, h v, h u², h u v, h v²` into the gradient of the ellipse. With `e = −(u² + v²)/2`:
/// `∂e/∂sigma_u = u²/sigma_u`, `∂e/∂sigma_v = v²/sigma_v`, `∂e/∂shear = u v sigma_u/sigma_v`,
/// `∂e/∂mean = (u/sigma_u − v shear/sigma_v, v/sigma_v)`; and `∂α/∂opacity = α/opacity`.
fn ellipse_gradient<F: Real>(e: &Ellipse<F>, moments: &[F], grad_depth: F, unscale: f64) -> Ellipse<F> {
    // `u` and `v` are scaled; a sum has them once or twice as factors.
    let (once, twice) = (F::of(unscale), F::of(unscale * unscale));
    let (h, hu, hv) = (moments[0], moments[1] * once, moments[2] * once);
    let [huu, huv, hvv] = [3, 4, 5].map(|i| moments[i] * twice);
    let per_v = hv / e.sigma_v;
    Ellipse {
        mean_px: [hu / e.sigma_u - e.shear * per_v, per_v],
        sigma_u: huu / e.sigma_u,
        shear: huv * (e.sigma_u / e.sigma_v),
        sigma_v: hvv / e.sigma_v,
        depth: grad_depth,
        opacity: h / e.opacity,
    }
}
