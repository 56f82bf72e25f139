//! The CPU twin of `rasterize_rays`: both passes, parallel over tiles. The gradient of each intersection has its own place,
//! and the gradients of a Gaussian are added in a fixed order, so the number of threads never changes a result.

use rayon::prelude::*;

use super::pixel::{RayGaussianCpu, RayLayerCpu, Rules, look};
use super::{RayLayers, SUMS};
use crate::depth_slope::DEPTH_SLOPE;
use crate::intersect::{IntersectionLists, TILE, tile_grid};
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::RasterizeSpec;
use crate::simd::real::Real;

/// A view with its Gaussians prepared for evaluation at pixels.
struct PreparedRayView<'a, F> {
    inputs: RayLayers<&'a [F]>,
    footprints: Vec<RayGaussianCpu<F>>,
    rules: Rules<F>,
    intersections: &'a IntersectionLists,
    size: [usize; 2],
    /// Number of features.
    channels: usize,
    depth: bool,
}

impl<'a, F: Real> PreparedRayView<'a, F> {
    fn new(inputs: RayLayers<&'a [F]>, spec: &RasterizeSpec, intersections: &'a IntersectionLists) -> Self {
        let rules = Rules::new(&spec.options);
        let rows = inputs.projected.chunks_exact(COLUMNS).zip(inputs.depth_slope.chunks_exact(DEPTH_SLOPE));
        Self {
            inputs,
            footprints: rows.map(|(row, depth_slope)| RayGaussianCpu::new(row, depth_slope, &rules)).collect(),
            rules,
            intersections,
            size: [spec.intrinsics.width, spec.intrinsics.height],
            channels: inputs.background.len(),
            depth: spec.options.depth,
        }
    }

    fn tiles(&self) -> usize {
        self.intersections.tile_start.len() - 1
    }

    fn gaussians(&self, tile: usize) -> &'a [u32] {
        &self.intersections.gaussian[self.intersections.tile_start[tile]..self.intersections.tile_start[tile + 1]]
    }

    /// The pixels of a tile, by their index in the picture.
    fn pixels(&self, tile: usize) -> impl Iterator<Item = usize> {
        let [width, height] = self.size;
        let across = tile_grid(width, height)[0];
        let (left, top) = (tile % across * TILE, tile / across * TILE);
        (top..height.min(top + TILE)).flat_map(move |y| (left..width.min(left + TILE)).map(move |x| y * width + x))
    }

    fn centre(&self, pixel: usize) -> [F; 2] {
        [pixel % self.size[0], pixel / self.size[0]].map(|px| F::of(px as f64 + 0.5))
    }

    fn feature(&self, gaussian: u32) -> &'a [F] {
        &self.inputs.features[gaussian as usize * self.channels..][..self.channels]
    }

    fn planes(&self) -> usize {
        self.channels + 1 + usize::from(self.depth)
    }
}

/// Returns the planes `[C + 1 (+ 1), H, W]`.
pub(crate) fn rasterize_rays_cpu<F: Real>(
    inputs: RayLayers<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
) -> Vec<F> {
    let view = PreparedRayView::new(inputs, spec, intersections);
    let (count, pixels) = (view.planes(), view.size[0] * view.size[1]);
    let of_tile = |layers: &mut Vec<RayLayerCpu<F>>, tile: usize| -> Vec<F> {
        let mut values = Vec::new();
        for pixel in view.pixels(tile) {
            let left = look(&view.footprints, view.gaussians(tile), view.centre(pixel), &view.rules, layers);
            let first = values.len();
            values.resize(first + count, F::ZERO);
            let out = &mut values[first..];
            for layer in layers.iter() {
                let weight = layer.alpha * layer.before;
                let feature = view.feature(layer.gaussian);
                out.iter_mut().zip(feature).for_each(|(sum, value)| *sum += weight * *value);
                if view.depth {
                    let footprint = &view.footprints[layer.gaussian as usize];
                    out[view.channels + 1] += weight * layer.depth(footprint, &view.rules);
                }
            }
            out.iter_mut().zip(inputs.background).for_each(|(sum, value)| *sum += left * *value);
            out[view.channels] = F::ONE - left;
        }
        values
    };
    let by_tile: Vec<Vec<F>> = (0..view.tiles()).into_par_iter().map_init(Vec::new, of_tile).collect();
    let mut planes = vec![F::ZERO; count * pixels];
    for (tile, values) in by_tile.iter().enumerate() {
        for (pixel, values) in view.pixels(tile).zip(values.chunks_exact(count)) {
            values.iter().enumerate().for_each(|(plane, value)| planes[plane * pixels + pixel] = *value);
        }
    }
    planes
}

/// Returns the gradients of the inputs from `grad`, the gradient of the planes.
pub(crate) fn rasterize_rays_backward_cpu<F: Real>(
    inputs: RayLayers<&[F]>,
    grad: &[F],
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
    needs: RayLayers<bool>,
) -> RayLayers<Vec<F>> {
    let view = PreparedRayView::new(inputs, spec, intersections);
    let columns = SUMS + view.channels + if needs.mean2d_abs { 2 } else { 0 };
    let mut rows = vec![F::ZERO; intersections.gaussian.len() * columns];
    let tasks: Vec<&mut [F]> = {
        let mut rest = rows.as_mut_slice();
        let ends = intersections.tile_start.windows(2).map(|w| w[1] - w[0]);
        ends.map(|count| rest.split_off_mut(..count * columns).expect("as many intersections as their lists")).collect()
    };
    let background: Vec<Vec<F>> = tasks
        .into_par_iter()
        .enumerate()
        .map_init(Vec::new, |layers, (tile, rows)| tile_backward(&view, grad, tile, (rows, columns), layers))
        .collect();
    let mut grads = gather(&view, &rows, columns, needs);
    if needs.background {
        grads.background = vec![F::ZERO; view.channels];
        for part in background {
            grads.background.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
        }
    }
    grads
}

/// Adds to a tile's rows, one per intersection, and returns its share of the background's gradient.
fn tile_backward<F: Real>(
    view: &PreparedRayView<F>,
    grad: &[F],
    tile: usize,
    (rows, columns): (&mut [F], usize),
    layers: &mut Vec<RayLayerCpu<F>>,
) -> Vec<F> {
    let (channels, pixels) = (view.channels, view.size[0] * view.size[1]);
    let mut background = vec![F::ZERO; channels];
    let mut own = vec![F::ZERO; channels];
    for pixel in view.pixels(tile) {
        let left = look(&view.footprints, view.gaussians(tile), view.centre(pixel), &view.rules, layers);
        own.iter_mut().enumerate().for_each(|(plane, own)| *own = grad[plane * pixels + pixel]);
        let grad_alpha = grad[channels * pixels + pixel];
        let grad_depth = if view.depth { grad[(channels + 1) * pixels + pixel] } else { F::ZERO };
        let along = |feature: &[F]| own.iter().zip(feature).map(|(g, c)| *g * *c).sum::<F>();
        // Contribution of everything behind the layer, as the gradient weighs it: g·R.
        let mut behind = along(view.inputs.background);
        for layer in layers.iter().rev() {
            let footprint = &view.footprints[layer.gaussian as usize];
            let depth = layer.depth(footprint, &view.rules);
            // Alpha acts as one more channel of colour one.
            let here = along(view.feature(layer.gaussian)) + grad_alpha + grad_depth * depth;
            let found = layer.backward(footprint, &view.rules, layer.before * (here - behind), grad_depth);
            behind = layer.alpha * here + (F::ONE - layer.alpha) * behind;
            let row = &mut rows[layer.place * columns..(layer.place + 1) * columns];
            row.iter_mut().zip(found.sums).for_each(|(sum, value)| *sum += value);
            row[SUMS..].iter_mut().zip(&own).for_each(|(sum, g)| *sum += found.weight * *g);
            row[SUMS + channels..].iter_mut().zip(found.mean2d).for_each(|(sum, value)| *sum += value.abs());
        }
        background.iter_mut().zip(&own).for_each(|(sum, g)| *sum += *g * left);
    }
    background
}

/// Adds each Gaussian's rows in order and turns the sums into gradients. Not parallel: the cost is small compared with the cost
/// of the pixels.
fn gather<F: Real>(view: &PreparedRayView<F>, rows: &[F], columns: usize, needs: RayLayers<bool>) -> RayLayers<Vec<F>> {
    let (count, channels, intersections) = (view.footprints.len(), view.channels, view.intersections);
    let zeros = |needed: bool, columns: usize| vec![F::ZERO; if needed { count * columns } else { 0 }];
    let mut grads = RayLayers {
        projected: zeros(needs.projected, COLUMNS),
        depth_slope: zeros(needs.depth_slope, DEPTH_SLOPE),
        features: zeros(needs.features, channels),
        background: Vec::new(),
        mean2d_abs: zeros(needs.mean2d_abs, 2),
    };
    let mut sums = vec![F::ZERO; columns];
    for (visible, &gaussian) in intersections.visible.iter().enumerate() {
        sums.fill(F::ZERO);
        let range = intersections.visible_start[visible] as usize..intersections.visible_start[visible + 1] as usize;
        for &intersection in &intersections.intersection_of_visible[range] {
            let row = &rows[intersection as usize * columns..(intersection as usize + 1) * columns];
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += *value);
        }
        let (i, e) = (gaussian as usize, &view.footprints[gaussian as usize].ellipse);
        if needs.projected {
            let [h, p, q, pu, qu, qv] = [0, 1, 2, 3, 4, 5].map(|column| sums[column]);
            let per_v = q / e.sigma_v;
            let grad = Ellipse {
                mean_px: [e.shear * per_v - p / e.sigma_u, -per_v],
                sigma_u: -(pu / e.sigma_u),
                shear: -(qu * (e.sigma_u / e.sigma_v)),
                sigma_v: -(qv / e.sigma_v),
                depth: sums[9],
                opacity: h / e.opacity,
            };
            grads.projected[i * COLUMNS..(i + 1) * COLUMNS].copy_from_slice(&grad.to_row());
        }
        if needs.depth_slope {
            grads.depth_slope[i * DEPTH_SLOPE..(i + 1) * DEPTH_SLOPE].copy_from_slice(&sums[6..6 + DEPTH_SLOPE]);
        }
        if needs.features {
            grads.features[i * channels..(i + 1) * channels].copy_from_slice(&sums[SUMS..SUMS + channels]);
        }
        if needs.mean2d_abs {
            grads.mean2d_abs[2 * i..2 * i + 2].copy_from_slice(&sums[SUMS + channels..]);
        }
    }
    grads
}
