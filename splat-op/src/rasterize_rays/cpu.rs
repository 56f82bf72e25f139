//! The CPU twin of `rasterize_rays`: both passes, parallel over tiles. The gradient of each intersection has its own place,
//! and the gradients of a Gaussian are added in a fixed order, so the number of threads never changes a result.

use std::sync::Arc;

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use super::RayLayers;
use super::footprint::{RayBox, RayFootprint, RayRules};
use super::lens::with_frames;
use super::tile::{ColourSlots, RayTile, RayTileView, rasterize_tile};
use super::tile_backward::{RayScratch, RayTileGrad, columns, rasterize_tile_backward};
use crate::camera::PictureRays;
use crate::depth_slope::{DEPTH_SLOPE, LensLimits};
use crate::intersect::{IntersectionLists, TILE, tile_grid};
use crate::options::{Order, Projection};
use crate::project::COLUMNS;
use crate::rasterize::cpu::{PictureSize, RowSums, TilePlanes, gather, picture, tile_rows};
use crate::rasterize::{Layers, RasterizeSpec};
use crate::simd::real::Real;

/// Number of Gaussians per task.
const CHUNK: usize = 1024;

/// A view with its Gaussians prepared for evaluation at pixels.
struct PreparedRayView<'a, F> {
    footprints: Vec<RayFootprint<F>>,
    boxes: Vec<RayBox<F>>,
    features: &'a [F],
    intersections: &'a IntersectionLists,
    size: PictureSize,
    /// The rays of a camera with a lens.
    rays: Option<Arc<PictureRays>>,
}

impl<'a, F: Real> PreparedRayView<'a, F> {
    fn new(inputs: &RayLayers<&'a [F]>, spec: &RasterizeSpec, intersections: &'a IntersectionLists) -> Self {
        let gaussians = (0..inputs.projected.len() / COLUMNS).into_par_iter().with_min_len(CHUNK);
        let rays = PictureRays::of(&spec.intrinsics);
        let lens = rays.as_ref().map(|rays| LensLimits::new(&spec.intrinsics, rays));
        let (footprints, boxes) = gaussians.map(|i| RayFootprint::new(inputs, i, (spec, lens.as_ref()))).unzip();
        Self {
            footprints,
            boxes,
            features: inputs.features,
            intersections,
            size: PictureSize {
                pixels: [spec.intrinsics.width, spec.intrinsics.height],
                features: inputs.background.len(),
                depth: spec.options.depth,
            },
            rays,
        }
    }

    fn view(&self, tile: usize) -> RayTileView<'_, F> {
        let [width, height] = self.size.pixels;
        let across = tile_grid(width, height)[0];
        let origin = [tile % across * TILE, tile / across * TILE];
        let starts = &self.intersections.tile_start;
        RayTileView {
            origin,
            rays: self.rays.as_ref().map(|rays| (width, &rays.slopes[..])),
            size: [0, 1].map(|axis| TILE.min(self.size.pixels[axis] - origin[axis])),
            gaussians: &self.intersections.gaussian[starts[tile]..starts[tile + 1]],
            footprints: &self.footprints,
            boxes: &self.boxes,
            features: self.features,
            channels: self.size.features,
        }
    }
}

/// Runs `$body` with the SIMD level of this processor as `$simd`, and with the render's projection and order as the constants
/// `$exact` and `$sorted`.
#[rustfmt::skip] // rustfmt indents the inner macro further at every run
macro_rules! specialised {
    ($spec:expr, $simd:ident, $exact:ident, $sorted:ident => $body:expr) => {{
        macro_rules! with {
            ($is_exact:literal, $is_sorted:literal) => {{
                const $exact: bool = $is_exact;
                const $sorted: bool = $is_sorted;
                dispatch!(Level::new(), $simd => $body)
            }};
        }
        match ($spec.options.projection == Projection::RayMax, $spec.options.order != Order::CentreDepth) {
            (false, false) => with!(false, false),
            (false, true) => with!(false, true),
            (true, false) => with!(true, false),
            (true, true) => with!(true, true),
        }
    }};
}

/// Returns the planes `[C + 1 (+ 1), H, W]`.
pub(crate) fn rasterize_rays_cpu<F: Real>(
    inputs: RayLayers<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
) -> Vec<F> {
    let prepared = PreparedRayView::new(&inputs, spec, intersections);
    let buffers = || (RayTile::default(), ColourSlots::default());
    let (planes, _) = picture(&prepared.size, inputs.background, buffers, |(tile, slots), index, planes| {
        tile.read(&prepared.view(index));
        specialised!(spec, simd, EXACT, SORTED => {
            let rules = RayRules::new(simd, spec);
            rasterize_tile::<_, F, EXACT, SORTED>(simd, tile, &rules, planes, slots);
        });
    });
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
    let prepared = PreparedRayView::new(&inputs, spec, intersections);
    let size = prepared.size;
    let columns = columns(size.channels(), needs.mean2d_abs);
    let buffers = || (RayTile::default(), TilePlanes::default(), RayScratch::default());
    let (rows, background) = tile_rows(intersections, [columns, size.features], buffers, |buffers, index, rows| {
        let (tile, planes, scratch) = buffers;
        let view = prepared.view(index);
        tile.read(&view);
        planes.read(grad, &size, view.origin, inputs.background);
        let grad = RayTileGrad { planes, depth: size.depth, absolute: needs.mean2d_abs };
        let transmittance = specialised!(spec, simd, EXACT, SORTED => {
            let rules = RayRules::new(simd, spec);
            rasterize_tile_backward::<_, F, EXACT, SORTED>(simd, tile, &rules, &grad, rows, scratch)
        });
        planes.background_gradient(&transmittance, if needs.background { size.features } else { 0 })
    });
    let sums = RowSums { rows: &rows, columns, channels: size.channels(), unscale: 1.0 };
    let RayLayers { projected, depth_slope, features, mean2d_abs, .. } = needs;
    let bends = depth_slope && prepared.rays.is_some();
    let needed = Layers { projected: projected || bends, features, background: false, mean2d_abs };
    let slopes = if depth_slope { DEPTH_SLOPE } else { 0 };
    let (grads, mut grad_slopes) = gather(inputs.projected, size.features, intersections, &sums, (needed, slopes));
    if bends {
        grad_slopes = with_frames(&inputs, &grads.projected, &grad_slopes, spec);
    }
    let Layers { projected: grad_projected, features, mean2d_abs, .. } = grads;
    RayLayers {
        projected: if projected { grad_projected } else { Vec::new() },
        depth_slope: grad_slopes,
        features,
        background: if needs.background { background } else { Vec::new() },
        mean2d_abs,
    }
}
