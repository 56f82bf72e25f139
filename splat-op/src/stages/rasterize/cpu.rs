//! CPU twin of `rasterize`: both passes, parallel over tiles. The gradient of each intersection is stored separately,
//! and those of a Gaussian are added in a fixed order, so the number of threads never changes a result.

use super::gather_cpu::{RowSums, gather};
use super::layer_cpu::Thresholds;
use super::pixels::{Plane, SIMD_WIDTH, in_block_order};
use super::prepared::Prepared;
pub(crate) use super::prepared::{SplatTrace, Trace};
use super::splat_cpu::Footprint;
use super::tile::{TileTrace, rasterize_tile};
use super::tile_backward::{BackwardPass, TileGrad, TileScratch};
use super::{Layers, MOMENTS, PlaneParts, RasterizeSpec};
use crate::intersect::{IntersectionLists, TILE_PIXELS, TILE_SIZE, tile_grid};
use crate::simd::real::Real;
use crate::simd::{dispatch, dispatch_widest, is_f32};
use crate::{ray_space, tasks};

/// Runs `$body` with a token of vector instructions as `$simd` and the number of channels as the constant `$c`, or zero if no
/// specialised version exists. `$long` is the constant of [`is_long`]. A plain colour picture, three channels in f32 without depth, has a version
/// for AVX-512.
#[rustfmt::skip] // rustfmt indents the inner macro further at every run
macro_rules! specialised {
    ($channels:expr, $is_long:expr, $simd:ident, $c:ident, $long:ident => $body:expr) => {{
        macro_rules! with {
            ($count:literal, $on_long:literal, $dispatch:ident) => {{
                const $c: usize = $count;
                const $long: bool = $on_long;
                $dispatch!(F, $simd => $body)
            }};
        }
        match ($channels, $is_long) {
            (1, false) if const { is_f32::<F>() && !P::ALONG_RAYS } => with!(1, false, dispatch),
            (3, false) if const { is_f32::<F>() && !P::ALONG_RAYS } => with!(3, false, dispatch_widest),
            (3, false) if const { is_f32::<F>() && P::ALONG_RAYS } => with!(3, false, dispatch),
            (4, false) if const { is_f32::<F>() } => with!(4, false, dispatch),
            (_, false) => with!(0, false, dispatch),
            (_, true) => with!(0, true, dispatch),
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
    if spec.options.along_rays() {
        let (planes, trace) = forward(inputs, spec, intersections, keep);
        (planes, trace.map(Trace::Rays))
    } else {
        let (planes, trace) = forward(inputs, spec, intersections, keep);
        (planes, trace.map(Trace::Ellipses))
    }
}

fn forward<F: Real, P: Footprint<F>>(
    inputs: Layers<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
    keep: bool,
) -> (Vec<F>, Option<SplatTrace<F, P>>) {
    let prepared = Prepared::<F, P>::new(&inputs, spec, intersections);
    let size = PictureSize { pixels: prepared.size, features: inputs.background.len(), depth: prepared.depth };
    let (planes, tiles) = picture(&size, inputs.background, |tile, planes| {
        let (view, long) = prepared.view(tile, &inputs, intersections);
        let mut trace = TileTrace::default();
        specialised!(prepared.channels, long, simd, C, IS_LONG => {
            let thresholds = Thresholds::<_, F>::new(simd, prepared.thresholds);
            rasterize_tile::<_, F, P, C, IS_LONG>(&view, &thresholds, planes, keep.then_some(&mut trace));
        });
        trace
    });
    (planes, keep.then_some(SplatTrace { prepared, tiles }))
}

/// Size of a picture and its numbers of planes.
#[derive(Clone, Copy)]
struct PictureSize {
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

/// Runs `tile` on all tiles in parallel. It writes a tile's sums and, last, its transmittance, `[channels + 1, 256]`. Returns
/// the picture's planes `[C + 1 (+ 1), H, W]` over the background, and the results of `tile`.
fn picture<F: Real, T: Send>(
    size: &PictureSize,
    background: &[F],
    tile: impl Fn(usize, &mut [F]) -> T + Sync,
) -> (Vec<F>, Vec<T>) {
    let plane_count = size.channels() + 1;
    let [width, height] = size.pixels;
    let grid = tile_grid(width, height);
    let mut planes = vec![F::ZERO; plane_count * width * height];
    // Each row of tiles has its rows in every plane.
    let mut strips: Vec<Vec<&mut [F]>> = (0..grid[1]).map(|_| Vec::with_capacity(plane_count)).collect();
    for plane in planes.chunks_mut(width * height) {
        strips.iter_mut().zip(plane.chunks_mut(TILE_SIZE * width)).for_each(|(strip, rows)| strip.push(rows));
    }
    let rasterize_strip = |y: usize, mut strip: Vec<&mut [F]>| {
        let mut by_tile = vec![F::ZERO; grid[0] * plane_count * TILE_PIXELS];
        let tiles = by_tile.chunks_mut(plane_count * TILE_PIXELS);
        let results = tasks::map_with(tiles, || (), |(), x, planes| tile(y * grid[0] + x, planes));
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
            for (tile, out) in row.chunks_mut(TILE_SIZE).enumerate() {
                let of = |plane: usize| {
                    let first = (tile * plane_count + plane) * TILE_PIXELS + y * TILE_SIZE;
                    &by_tile[first..first + TILE_SIZE]
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
    intersections: &IntersectionLists,
    trace: Option<&Trace<F>>,
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
    match trace {
        Trace::Ellipses(trace) => backward(inputs, grad, spec, intersections, trace, needs),
        Trace::Rays(trace) => backward(inputs, grad, spec, intersections, trace, needs),
    }
}

fn backward<F: Real, P: Footprint<F>>(
    inputs: Layers<&[F]>,
    grad: PlaneParts<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
    trace: &SplatTrace<F, P>,
    needs: Layers<bool>,
) -> Layers<Vec<F>> {
    let prepared = &trace.prepared;
    let columns = MOMENTS + prepared.channels + P::EXTRA_COLUMNS + if needs.mean2d_abs { 2 } else { 0 };
    let features = inputs.background.len();
    let size = PictureSize { pixels: prepared.size, features, depth: prepared.depth };
    // Fills a tile's sums per intersection and returns its share of the background's gradient if it is needed.
    let fill = |Buffers { grad: of_planes, scratch }: &mut Buffers<F>, tile: usize, sums: &mut [F]| {
        let (view, long) = prepared.view(tile, &inputs, intersections);
        of_planes.read(grad, &size, view.origin, inputs.background);
        let wanted = if needs.background { features } else { 0 };
        if of_planes.is_zero() {
            return vec![F::ZERO; wanted];
        }
        let TilePlanes { planes, background_rho } = of_planes;
        let (trace, absolute, finite, depth) = (&trace.tiles[tile], needs.mean2d_abs, prepared.finite, prepared.depth);
        let tile_grad = TileGrad { planes, background_rho, trace, absolute, finite, depth };
        let mut transmittance = [F::ZERO; TILE_PIXELS];
        specialised!(prepared.channels, long, simd, C, IS_LONG => {
            let thresholds = Thresholds::<_, F>::new(simd, prepared.thresholds);
            let pass = BackwardPass::new(&view, &tile_grad, &thresholds);
            pass.run::<P, C, IS_LONG>(&view, sums, &mut transmittance, scratch);
        });
        of_planes.background_gradient(&transmittance, wanted)
    };
    let mut rows = vec![F::ZERO; intersections.gaussian.len() * columns];
    let mut rest = rows.as_mut_slice();
    let counts = intersections.tile_start.windows(2).map(|ends| ends[1] - ends[0]);
    let of_tile = |count: usize| rest.split_off_mut(..count * columns).expect("as many intersections as their lists");
    let parts = tasks::map_with(counts.map(of_tile), Buffers::default, fill);
    let mut background = vec![F::ZERO; features];
    for part in parts {
        background.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
    }
    let ray_columns = if P::ALONG_RAYS { ray_space::columns(&spec.intrinsics) } else { 0 };
    let sums = RowSums { rows: &rows, columns, channels: prepared.channels, unscale: P::UNSCALE };
    let grads = gather(inputs.projected, features, intersections, &sums, needs, ray_columns);
    Layers { background: if needs.background { background } else { Vec::new() }, ..grads }
}

/// Buffers of one thread.
#[derive(Default)]
struct Buffers<F: Real> {
    grad: TilePlanes<F>,
    scratch: TileScratch<F>,
}

/// Gradients of a tile's planes.
#[derive(Default)]
struct TilePlanes<F> {
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
            for row in 0..TILE_SIZE.min(height - origin[1]) {
                let first = (source * height + origin[1] + row) * width + origin[0];
                let values = &grad[first..first + TILE_SIZE.min(width - origin[0])];
                for (four, values) in values.chunks(SIMD_WIDTH).enumerate() {
                    let place = in_block_order(row * (TILE_SIZE / SIMD_WIDTH) + four);
                    // Four values are copied as a vector, fewer of them by a call.
                    let four = values.as_array().copied().unwrap_or_else(|| {
                        let mut four = [F::ZERO; SIMD_WIDTH];
                        four[..values.len()].copy_from_slice(values);
                        four
                    });
                    self.planes[plane].as_chunks_mut().0[place] = four;
                    if plane < features {
                        let background_rho = &mut self.background_rho.as_chunks_mut::<SIMD_WIDTH>().0[place];
                        background_rho.iter_mut().zip(four).for_each(|(sum, g)| *sum += g * background[plane]);
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
