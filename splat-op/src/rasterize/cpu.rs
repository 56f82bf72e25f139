//! CPU twin of `rasterize`: both passes, parallel over tiles. The gradient of each intersection is stored separately,
//! and those of a Gaussian are added in a fixed order, so the number of threads never changes a result.

use std::borrow::Cow;

use super::footprint::{Footprint, UNWHITEN, WIDTH};
use super::prepared::Prepared;
use super::tile::{Plane, Thresholds, TileTrace, in_block_order, rasterize_tile};
pub(crate) use super::tile_backward::MOMENTS;
use super::tile_backward::{TileGrad, TileScratch, rasterize_tile_backward};
use super::{Layers, PlaneParts, RasterizeSpec};
use crate::intersect::{IntersectionLists, TILE, TILE_PIXELS, tile_grid};
use crate::project::{COLUMNS, Ellipse, OPACITY};
use crate::ray_space::{SHAPE, SLOPES};
use crate::simd::real::Real;
use crate::simd::{dispatch, is_f32};
use crate::tasks;

/// Number of Gaussians per task.
pub(super) const CHUNK: usize = 1024;

/// Values that the forward pass keeps for the backward pass.
pub(crate) struct Trace<F> {
    pub(super) footprints: Vec<Footprint<F>>,
    /// Features and depth of each Gaussian if depth is rendered; otherwise nothing.
    pub(super) colours: Vec<F>,
    tiles: Vec<TileTrace<F>>,
}

/// Runs `$body` with the SIMD level of this processor as `$simd` and the number of channels as the constant `$c`, or
/// zero if no specialised version exists. `$long` is the constant of [`is_long`].
#[rustfmt::skip] // rustfmt indents the inner macro further at every run
macro_rules! specialised {
    ($prepared:expr, $tile:expr, $simd:ident, $c:ident, $long:ident => $body:expr) => {{
        macro_rules! with {
            ($count:literal, $is_long:literal) => {{
                const $c: usize = $count;
                const $long: bool = $is_long;
                dispatch!(F, $simd => $body)
            }};
        }
        match ($prepared.channels, $prepared.is_long($tile)) {
            (1, false) if const { is_f32::<F>() } => with!(1, false),
            (3, false) if const { is_f32::<F>() } => with!(3, false),
            (4, false) if const { is_f32::<F>() } => with!(4, false),
            (_, false) => with!(0, false),
            (_, true) => with!(0, true),
        }
    }};
}

/// Runs the forward pass. Returns the planes `[C + 1 (+ 1), H, W]`, and the trace if `keep` is set.
pub(crate) fn rasterize_cpu<F: Real>(
    inputs: Layers<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
    keep: bool,
) -> (Vec<F>, Option<Trace<F>>) {
    let prepared = Prepared::new(inputs, spec, intersections, None);
    let size = PictureSize { pixels: prepared.size, features: inputs.background.len(), depth: spec.options.depth };
    let (planes, traces) = picture(
        &size,
        inputs.background,
        || (),
        |(), tile, planes| {
            let view = prepared.view(tile);
            let mut trace = TileTrace::default();
            specialised!(prepared, tile, simd, C, IS_LONG => {
                let thresholds = Thresholds::<_, F>::new(simd, prepared.thresholds);
                rasterize_tile::<_, F, C, IS_LONG>(simd, &view, &thresholds, planes, keep.then_some(&mut trace));
            });
            trace
        },
    );
    let Prepared { footprints, colours, .. } = prepared;
    let colours = if let Cow::Owned(colours) = colours { colours } else { Vec::new() };
    (planes, keep.then_some(Trace { footprints: footprints.into_owned(), colours, tiles: traces }))
}

/// Size of a picture and its numbers of planes.
#[derive(Clone, Copy)]
pub(crate) struct PictureSize {
    /// Width and height, px.
    pub pixels: [usize; 2],
    pub features: usize,
    /// Whether depth is accumulated.
    pub depth: bool,
}

impl PictureSize {
    /// Number of channels that a tile sums: the features, then depth.
    pub fn channels(&self) -> usize {
        self.features + usize::from(self.depth)
    }
}

/// Runs `tile` on all tiles in parallel, each time with the `buffers` of its thread. It writes a tile's sums and, last, its transmittance, `[channels + 1, 256]`. Returns
/// the picture's planes `[C + 1 (+ 1), H, W]` over the background, and the results of `tile`.
pub(crate) fn picture<F: Real, B: Send, T: Send>(
    size: &PictureSize,
    background: &[F],
    buffers: impl Fn() -> B + Sync,
    tile: impl Fn(&mut B, usize, &mut [F]) -> T + Sync,
) -> (Vec<F>, Vec<T>) {
    let plane_count = size.channels() + 1;
    let [width, height] = size.pixels;
    let grid = tile_grid(width, height);
    let mut planes = vec![F::ZERO; plane_count * width * height];
    // Each row of tiles has its rows in every plane.
    let mut strips: Vec<Vec<&mut [F]>> = (0..grid[1]).map(|_| Vec::with_capacity(plane_count)).collect();
    for plane in planes.chunks_mut(width * height) {
        strips.iter_mut().zip(plane.chunks_mut(TILE * width)).for_each(|(strip, rows)| strip.push(rows));
    }
    let rasterize_strip = |y: usize, mut strip: Vec<&mut [F]>| {
        let mut by_tile = vec![F::ZERO; grid[0] * plane_count * TILE_PIXELS];
        let tiles = by_tile.chunks_mut(plane_count * TILE_PIXELS);
        let results = tasks::map_with(tiles, &buffers, |buffers, x, planes| tile(buffers, y * grid[0] + x, planes));
        compose(&by_tile, background, size, &mut strip);
        results
    };
    let results: Vec<Vec<T>> = tasks::map(strips, rasterize_strip);
    (planes, results.into_iter().flatten().collect())
}

/// Composes the sums and transmittances of a row of tiles over the background into its part of each plane.
fn compose<F: Real>(by_tile: &[F], background: &[F], size: &PictureSize, strip: &mut [&mut [F]]) {
    let (width, features) = (size.pixels[0], size.features);
    let plane_count = size.channels() + 1;
    for (plane, rows) in strip.iter_mut().enumerate() {
        for (y, row) in rows.chunks_mut(width).enumerate() {
            for (tile, out) in row.chunks_mut(TILE).enumerate() {
                let of = |plane: usize| {
                    let first = (tile * plane_count + plane) * TILE_PIXELS + y * TILE;
                    &by_tile[first..first + TILE]
                };
                let transmittance = of(size.channels());
                match plane {
                    _ if plane < features => {
                        let composed =
                            of(plane).iter().zip(transmittance).map(|(&sum, &t)| sum + t * background[plane]);
                        out.iter_mut().zip(composed).for_each(|(out, value)| *out = value);
                    }
                    // In the picture alpha precedes depth; in the tile it is last.
                    _ if plane == features => {
                        out.iter_mut().zip(transmittance).for_each(|(out, &t)| *out = F::ONE - t);
                    }
                    _ => out.copy_from_slice(&of(features)[..out.len()]),
                }
            }
        }
    }
}

/// Returns the gradients of the inputs from `grad`, those of the planes; one that is empty is zero. Without a trace the forward
/// pass runs again.
pub(crate) fn rasterize_backward_cpu<F: Real>(
    inputs: Layers<&[F]>,
    grad: PlaneParts<&[F]>,
    spec: &RasterizeSpec,
    (intersections, trace): (&IntersectionLists, Option<&Trace<F>>),
    needs: Layers<bool>,
) -> Layers<Vec<F>> {
    let rebuilt;
    let trace = match trace {
        Some(trace) => trace,
        None => {
            rebuilt = rasterize_cpu(inputs, spec, intersections, true).1.expect("a trace was asked for");
            &rebuilt
        }
    };
    let prepared = Prepared::new(inputs, spec, intersections, Some(trace));
    let columns = MOMENTS + prepared.channels + if needs.mean2d_abs { 2 } else { 0 };
    let features = inputs.background.len();
    let (rows, background) = tile_rows(intersections, [columns, features], Buffers::default, |buffers, tile, sums| {
        tile_sums(&prepared, inputs.background, grad, &trace.tiles[tile], (tile, sums, needs), buffers)
    });
    let sums = RowSums { rows: &rows, columns, channels: prepared.channels, unscale: UNWHITEN };
    let (grads, _) = gather(inputs.projected, features, intersections, &sums, (needs, 0));
    Layers { background: if needs.background { background } else { Vec::new() }, ..grads }
}

/// Runs `tile` on each tile's rows, `columns` values per intersection, in parallel. Returns all rows, and the sums of
/// the `features` values, or none, that `tile` returns.
pub(crate) fn tile_rows<F: Real, B: Send>(
    intersections: &IntersectionLists,
    [columns, features]: [usize; 2],
    buffers: impl Fn() -> B + Sync,
    tile: impl Fn(&mut B, usize, &mut [F]) -> Vec<F> + Sync,
) -> (Vec<F>, Vec<F>) {
    let mut rows = vec![F::ZERO; intersections.gaussian.len() * columns];
    let mut rest = rows.as_mut_slice();
    let counts = intersections.tile_start.windows(2).map(|ends| ends[1] - ends[0]);
    let of_tile = |count: usize| rest.split_off_mut(..count * columns).expect("as many intersections as their lists");
    let parts = tasks::map_with(counts.map(of_tile), buffers, tile);
    let mut sums = vec![F::ZERO; features];
    for part in parts {
        sums.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
    }
    (rows, sums)
}

/// Buffers of one thread.
#[derive(Default)]
struct Buffers<F: Real> {
    grad: TilePlanes<F>,
    scratch: TileScratch<F>,
}

/// Fills one tile's sums per intersection and returns its share of the background's gradient if it is needed.
fn tile_sums<F: Real>(
    prepared: &Prepared<F>,
    background: &[F],
    grad: PlaneParts<&[F]>,
    trace: &TileTrace<F>,
    (tile, sums, needs): (usize, &mut [F], Layers<bool>),
    buffers: &mut Buffers<F>,
) -> Vec<F> {
    let view = prepared.view(tile);
    let features = background.len();
    let size = PictureSize { pixels: prepared.size, features, depth: prepared.channels > features };
    let Buffers { grad: of_planes, scratch } = buffers;
    of_planes.read(grad, &size, view.origin, background);
    let wanted = if needs.background { features } else { 0 };
    if of_planes.is_zero() {
        return vec![F::ZERO; wanted];
    }
    let TilePlanes { planes, background_rho } = of_planes;
    let tile_grad = TileGrad { planes, background_rho, trace, absolute: needs.mean2d_abs, finite: prepared.finite };
    let mut transmittance = [F::ZERO; TILE_PIXELS];
    specialised!(prepared, tile, simd, C, IS_LONG => {
        let thresholds = Thresholds::<_, F>::new(simd, prepared.thresholds);
        let out = (sums, &mut transmittance);
        rasterize_tile_backward::<_, F, C, IS_LONG>(simd, &view, &tile_grad, &thresholds, out, scratch);
    });
    of_planes.background_gradient(&transmittance, wanted)
}

/// Gradients of a tile's planes.
#[derive(Default)]
pub(crate) struct TilePlanes<F> {
    /// `[channels + 1, 256]`: gradients of the sums `Σ w c` and of alpha; zero outside the picture.
    pub planes: Vec<Plane<F>>,
    /// `[256]`: `g · background`, behind all layers.
    pub background_rho: Vec<F>,
}

impl<F: Real> TilePlanes<F> {
    /// Fills them, for the tile with its first pixel at `origin`, from the gradients of the picture's planes.
    pub fn read(&mut self, grad: PlaneParts<&[F]>, size: &PictureSize, origin: [usize; 2], background: &[F]) {
        let ([width, height], features, channels) = (size.pixels, size.features, size.channels());
        self.planes.clear();
        self.planes.resize(channels + 1, [F::ZERO; TILE_PIXELS]);
        self.background_rho.clear();
        self.background_rho.resize(TILE_PIXELS, F::ZERO);
        for plane in 0..=channels {
            let (grad, source) = match plane {
                _ if plane == channels => (grad.alpha, 0),
                _ if plane == features => (grad.depth, 0),
                _ => (grad.colour, plane),
            };
            if grad.is_empty() {
                continue;
            }
            for row in 0..TILE.min(height - origin[1]) {
                let first = (source * height + origin[1] + row) * width + origin[0];
                let values = &grad[first..first + TILE.min(width - origin[0])];
                for (half, values) in values.chunks(WIDTH).enumerate() {
                    // Eight values are copied as a vector, fewer of them by a call.
                    let eight = values.as_array().copied().unwrap_or_else(|| {
                        let mut eight = [F::ZERO; WIDTH];
                        eight[..values.len()].copy_from_slice(values);
                        eight
                    });
                    let place = in_block_order(row * (TILE / WIDTH) + half);
                    self.planes[plane].as_chunks_mut().0[place] = eight;
                    if plane < features {
                        let background_rho = &mut self.background_rho.as_chunks_mut::<WIDTH>().0[place];
                        background_rho.iter_mut().zip(eight).for_each(|(sum, g)| *sum += g * background[plane]);
                    }
                }
            }
        }
    }

    /// Whether no plane has a gradient, as where a mask covers the tile. Then nothing in the tile has one.
    pub fn is_zero(&self) -> bool {
        self.planes.iter().flatten().all(|value| *value == F::ZERO)
    }

    /// Returns the tile's share of the gradient of the background's first `features` values. `transmittance` is that behind
    /// all layers, negated where a pixel is finished.
    pub fn background_gradient(&self, transmittance: &Plane<F>, features: usize) -> Vec<F> {
        let through = |plane: &Plane<F>| plane.iter().zip(transmittance).map(|(&g, t)| g * t.abs()).sum();
        self.planes.iter().take(features).map(through).collect()
    }
}

/// Sums over each tile, a row per intersection: the moments, the channels (depth is the last), along rays the gradient of the depth
/// slope and of the centre's relative depth, and in the last two columns the sums of absolute values if they are wanted.
pub(crate) struct RowSums<'a, F> {
    pub rows: &'a [F],
    pub columns: usize,
    pub channels: usize,
    /// The inverse of the factor in `u` and `v`.
    pub unscale: f64,
}

/// Adds the sums of each Gaussian's intersections in order and turns them into gradients of its ellipse and `features`
/// features. With `ray_columns` above zero the Gaussian was seen along rays: the gradient of its shape goes to its row of `ray_space`,
/// which has as many columns, and the ellipse keeps that of its opacity.
pub(crate) fn gather<F: Real>(
    ellipses: &[F],
    features: usize,
    intersections: &IntersectionLists,
    sums: &RowSums<F>,
    (needs, ray_columns): (Layers<bool>, usize),
) -> (Layers<Vec<F>>, Vec<F>) {
    let RowSums { rows, columns, channels, unscale } = *sums;
    let (count, lists) = (ellipses.len() / COLUMNS, intersections);
    let zeros = |needed: bool, columns: usize| vec![F::ZERO; if needed { count * columns } else { 0 }];
    let mut grads = Layers {
        projected: zeros(needs.projected, COLUMNS),
        features: zeros(needs.features, features),
        background: Vec::new(),
        mean2d_abs: zeros(needs.mean2d_abs, 2),
    };
    let mut grad_rays = zeros(true, ray_columns);
    let of_ellipses = chunks(&mut grads.projected, COLUMNS, count).into_iter();
    let of_features = chunks(&mut grads.features, features, count);
    let others = chunks(&mut grads.mean2d_abs, 2, count).into_iter().zip(chunks(&mut grad_rays, ray_columns, count));
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
            if needs.projected || ray_columns > 0 {
                let ellipse = Ellipse::from_row(&ellipses[(first + i) * COLUMNS..]);
                let depth = if channels > features { colours[features] } else { F::ZERO };
                let mut grad = ellipse_gradient(&ellipse, moments, depth, unscale).to_row();
                if ray_columns > 0 {
                    let ray = &mut ray[i * ray_columns..][..ray_columns];
                    ray[..SLOPES].copy_from_slice(&colours[channels..channels + SLOPES]);
                    ray[SLOPES..SLOPES + SHAPE].copy_from_slice(&grad[..SHAPE]);
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
    (grads, grad_rays)
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

/// [`add_rows`] for a length known at compile time: the fewer instructions a row takes, the more rows are fetched at a
/// time.
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
