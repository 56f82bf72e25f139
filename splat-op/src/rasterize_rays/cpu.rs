//! The CPU twin of `rasterize_rays`: both passes, parallel over tiles. The gradient of each intersection has its own place,
//! and the gradients of a Gaussian are added in a fixed order, so the number of threads never changes a result.

use rayon::prelude::*;

use super::RayLayers;
use super::pixel::{RayGaussianCpu, RayLayerCpu, Rules, look};
use crate::depth_slope::DEPTH_SLOPE;
use crate::intersect::{IntersectionLists, TILE, tile_grid};
use crate::project::COLUMNS;
use crate::rasterize::cpu::{MOMENTS, RowSums, gather, tile_rows};
use crate::rasterize::{Layers, RasterizeSpec};
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
}

/// Returns the planes `[C + 1 (+ 1), H, W]`.
pub(crate) fn rasterize_rays_cpu<F: Real>(
    inputs: RayLayers<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
) -> Vec<F> {
    let view = PreparedRayView::new(inputs, spec, intersections);
    let (count, pixels) = (spec.planes(view.channels), view.size[0] * view.size[1]);
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
    let tiles = 0..intersections.tile_start.len() - 1;
    let by_tile: Vec<Vec<F>> = tiles.into_par_iter().map_init(Vec::new, of_tile).collect();
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
    let channels = view.channels + usize::from(view.depth);
    let columns = MOMENTS + channels + DEPTH_SLOPE + if needs.mean2d_abs { 2 } else { 0 };
    let (rows, background) = tile_rows(intersections, [columns, view.channels], Vec::new, |layers, tile, rows| {
        tile_backward(&view, grad, tile, (rows, columns), layers)
    });
    let sums = RowSums { rows: &rows, columns, channels, unscale: 1.0 };
    let RayLayers { projected, depth_slope, features, mean2d_abs, .. } = needs;
    let needed = Layers { projected, features, background: false, mean2d_abs };
    let slopes = if depth_slope { DEPTH_SLOPE } else { 0 };
    let (grads, depth_slope) = gather(inputs.projected, view.channels, intersections, &sums, (needed, slopes));
    let Layers { projected, features, mean2d_abs, .. } = grads;
    RayLayers {
        projected,
        depth_slope,
        features,
        background: if needs.background { background } else { Vec::new() },
        mean2d_abs,
    }
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
            row.iter_mut().zip(found.moments).for_each(|(sum, value)| *sum += value);
            row[MOMENTS..].iter_mut().zip(&own).for_each(|(sum, g)| *sum += found.weight * *g);
            if view.depth {
                row[MOMENTS + channels] += found.depth;
            }
            let rest = &mut row[MOMENTS + channels + usize::from(view.depth)..];
            rest.iter_mut().zip(found.rest).for_each(|(sum, value)| *sum += value);
        }
        background.iter_mut().zip(&own).for_each(|(sum, g)| *sum += *g * left);
    }
    background
}
