//! The CPU twin of `rasterize_rays`: both passes, parallel over tiles. The gradient of each intersection has its own place,
//! and the gradients of a Gaussian are added in a fixed order, so the number of threads never changes a result.

use std::borrow::Cow;
use std::sync::Arc;

use super::RayLayers;
use super::footprint::{RayFootprint, RayRules};
use super::reach::Reach;
use super::tile::{RayTile, RayTileView, rasterize_tile};
use super::tile_backward::{RayScratch, RayTileGrad, columns, rasterize_tile_backward};
use crate::camera::PictureRays;
use crate::intersect::{IntersectionLists, TILE, tile_grid};
use crate::project::COLUMNS;
use crate::rasterize::cpu::{PictureSize, RowSums, TilePlanes, gather, picture, tile_rows};
use crate::rasterize::{Layers, PlaneParts, RasterizeSpec};
use crate::ray_space::{self, LensLimits};
use crate::simd::dispatch;
use crate::simd::real::Real;
use crate::tasks;

/// Number of Gaussians per task.
const CHUNK: usize = 1024;

/// Values that the forward pass keeps for the backward pass.
pub(crate) struct RayTrace<F> {
    footprints: Vec<RayFootprint<F>>,
    /// For each tile, by place in its list, a bit for each block that sees the Gaussian.
    seen: Vec<Vec<u16>>,
}

#[cfg(test)]
impl<F: Real> RayTrace<F> {
    /// Number of pairs of a Gaussian and a block.
    pub fn pairs(&self) -> usize {
        self.seen.iter().flatten().map(|seen| seen.count_ones() as usize).sum()
    }

    /// A trace with every pair.
    pub fn whole(&self) -> Self {
        let seen = self.seen.iter().map(|tile| vec![u16::MAX; tile.len()]).collect();
        Self { footprints: self.footprints.clone(), seen }
    }
}

/// A view with its Gaussians prepared for evaluation at pixels.
struct PreparedRayView<'a, F: Clone> {
    footprints: Cow<'a, [RayFootprint<F>]>,
    ray_space: &'a [F],
    features: &'a [F],
    intersections: &'a IntersectionLists,
    size: PictureSize,
    /// The rays of a camera with a lens.
    rays: Option<Arc<PictureRays>>,
}

impl<'a, F: Real> PreparedRayView<'a, F> {
    fn new(
        inputs: &RayLayers<&'a [F]>,
        spec: &RasterizeSpec,
        intersections: &'a IntersectionLists,
        footprints: Option<&'a [RayFootprint<F>]>,
    ) -> Self {
        let rays = PictureRays::of(&spec.intrinsics);
        let footprints = match footprints {
            Some(footprints) => Cow::Borrowed(footprints),
            None => {
                let lens = rays.as_ref().map(|rays| LensLimits::new(&spec.intrinsics, rays));
                let mut all = vec![RayFootprint::default(); inputs.projected.len() / COLUMNS];
                tasks::for_each(all.chunks_mut(CHUNK), |chunk, out| {
                    for (i, out) in (chunk * CHUNK..).zip(out) {
                        *out = RayFootprint::new(inputs, i, (spec, lens.as_ref()));
                    }
                });
                Cow::Owned(all)
            }
        };
        Self {
            footprints,
            ray_space: inputs.ray_space,
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
            ray_space: self.ray_space,
            features: self.features,
            channels: self.size.features,
        }
    }
}

/// Returns the planes `[C + 1 (+ 1), H, W]`, and the trace if `keep` is set.
pub(crate) fn rasterize_rays_cpu<F: Real>(
    inputs: RayLayers<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
    keep: bool,
) -> (Vec<F>, Option<RayTrace<F>>) {
    let prepared = PreparedRayView::new(&inputs, spec, intersections, None);
    let (planes, seen) = picture(&prepared.size, inputs.background, RayTile::default, |tile, index, planes| {
        let view = prepared.view(index);
        let seen = dispatch!(F, simd => {
            let rules = RayRules::new(simd, spec);
            tile.read(simd, &view, Reach::Boxes(&intersections.boxes));
            rasterize_tile(simd, tile, &rules, planes)
        });
        if keep { seen } else { Vec::new() }
    });
    let footprints = prepared.footprints.into_owned();
    (planes, keep.then_some(RayTrace { footprints, seen }))
}

/// Returns the gradients of the inputs from `grad`, those of the planes; one that is empty is zero. Without a trace the forward pass
/// runs again.
pub(crate) fn rasterize_rays_backward_cpu<F: Real>(
    inputs: RayLayers<&[F]>,
    grad: PlaneParts<&[F]>,
    spec: &RasterizeSpec,
    (intersections, trace): (&IntersectionLists, Option<&RayTrace<F>>),
    needs: RayLayers<bool>,
) -> RayLayers<Vec<F>> {
    let rebuilt;
    let trace = match trace {
        Some(trace) => trace,
        None => {
            rebuilt = rasterize_rays_cpu(inputs, spec, intersections, true).1.expect("a trace was asked for");
            &rebuilt
        }
    };
    let prepared = PreparedRayView::new(&inputs, spec, intersections, Some(&trace.footprints));
    let size = prepared.size;
    let columns = columns(size.channels(), needs.mean2d_abs);
    let buffers = || (RayTile::default(), TilePlanes::default(), RayScratch::default());
    let (rows, background) = tile_rows(intersections, [columns, size.features], buffers, |buffers, index, rows| {
        let (tile, planes, scratch) = buffers;
        let view = prepared.view(index);
        planes.read(grad, &size, view.origin, inputs.background);
        let wanted = if needs.background { size.features } else { 0 };
        if planes.is_zero() {
            return vec![F::ZERO; wanted];
        }
        let grad = RayTileGrad { planes, depth: size.depth, absolute: needs.mean2d_abs };
        let transmittance = dispatch!(F, simd => {
            let rules = RayRules::new(simd, spec);
            tile.read(simd, &view, Reach::Blocks(&trace.seen[index]));
            rasterize_tile_backward(simd, tile, &rules, &grad, rows, scratch)
        });
        planes.background_gradient(&transmittance, wanted)
    });
    let sums = RowSums { rows: &rows, columns, channels: size.channels(), unscale: 1.0 };
    let RayLayers { projected, ray_space, features, mean2d_abs, .. } = needs;
    let needed = Layers { projected, features, background: false, mean2d_abs };
    let ray_columns = ray_space::columns(&spec.intrinsics);
    let (grads, of_rays) = gather(inputs.projected, size.features, intersections, &sums, (needed, ray_columns));
    let Layers { projected, features, mean2d_abs, .. } = grads;
    RayLayers {
        projected,
        ray_space: if ray_space { of_rays } else { Vec::new() },
        features,
        background: if needs.background { background } else { Vec::new() },
        mean2d_abs,
    }
}
