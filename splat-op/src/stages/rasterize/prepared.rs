//! Preparation of the CPU twin's inputs before its loops over the tiles.

use std::sync::Arc;

use super::footprint::EllipseFootprint;
use super::layer_cpu::is_long;
use super::pixels::TileView;
use super::splat_cpu::{Footprint, FootprintView};
use super::tile::{TileTrace, is_finite};
use super::{Layers, RasterizeSpec};
use crate::camera::PictureRays;
use crate::intersect::{IntersectionLists, TILE_SIZE, tile_grid};
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize_rays::footprint::RayFootprint;
use crate::ray_space::LensLimits;
use crate::simd::real::Real;
use crate::tasks;

/// Number of Gaussians per task.
pub(super) const CHUNK: usize = 1024;

/// Values that the forward pass keeps for the backward pass.
pub(crate) enum Trace<F> {
    Ellipses(SplatTrace<F, EllipseFootprint<F>>),
    Rays(SplatTrace<F, RayFootprint<F>>),
}

/// A trace of one kind of splats.
pub(crate) struct SplatTrace<F, P> {
    pub(super) prepared: Prepared<F, P>,
    pub(super) tiles: Vec<TileTrace<F>>,
}

/// A view in the form that the loops over the tiles read.
pub(super) struct Prepared<F, P> {
    footprints: Vec<P>,
    /// Features and depth of each Gaussian if depth is rendered; otherwise nothing.
    with_depth: Vec<F>,
    pub channels: usize,
    /// Whether depth is the last channel.
    pub depth: bool,
    /// The rays of a camera with a lens, if Gaussians are seen along rays.
    rays: Option<Arc<PictureRays>>,
    /// Whether all colours are finite.
    pub finite: bool,
    pub grid: [usize; 2],
    pub size: [usize; 2],
    pub thresholds: [F; 3],
}

/// Returns the features of each Gaussian, followed by its depth: `[N, features + 1]`.
fn with_depth<F: Real>(inputs: &Layers<&[F]>, features: usize) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.projected.len() / COLUMNS * (features + 1)];
    let chunks = inputs.projected.chunks(COLUMNS * CHUNK).zip(inputs.features.chunks(features * CHUNK));
    tasks::for_each(out.chunks_mut((features + 1) * CHUNK).zip(chunks), |_, (out, (ellipses, of_chunk))| {
        let rows = of_chunk.chunks_exact(features).zip(ellipses.chunks_exact(COLUMNS));
        for (out, (row, ellipse)) in out.chunks_exact_mut(features + 1).zip(rows) {
            out[..features].copy_from_slice(row);
            out[features] = Ellipse::from_row(ellipse).depth;
        }
    });
    out
}

/// Returns the footprint of each Gaussian.
fn footprints<F: Real, P: Footprint<F>>(inputs: &Layers<&[F]>, view: &FootprintView<F>) -> Vec<P> {
    let mut all = vec![P::default(); inputs.projected.len() / COLUMNS];
    tasks::for_each(all.chunks_mut(CHUNK), |chunk, out| {
        (chunk * CHUNK..).zip(out).for_each(|(i, out)| *out = P::read(inputs, i, view));
    });
    all
}

impl<F: Real, P: Footprint<F>> Prepared<F, P> {
    pub fn new(inputs: &Layers<&[F]>, spec: &RasterizeSpec, intersections: &IntersectionLists) -> Self {
        let options = &spec.options;
        let rays = if P::ALONG_RAYS { PictureRays::of(&spec.intrinsics) } else { None };
        let lens = rays.as_ref().map(|rays| LensLimits::new(&spec.intrinsics, rays));
        let features = inputs.background.len();
        let with_depth = if options.depth { with_depth(inputs, features) } else { Vec::new() };
        Self {
            footprints: footprints(inputs, &FootprintView { spec, lens, boxes: &intersections.boxes }),
            finite: is_finite(if options.depth { &with_depth[..] } else { inputs.features }),
            with_depth,
            channels: features + usize::from(options.depth),
            depth: options.depth,
            rays,
            grid: tile_grid(spec.intrinsics.width, spec.intrinsics.height),
            size: [spec.intrinsics.width, spec.intrinsics.height],
            thresholds: [F::of(options.alpha_min), F::of(options.alpha_max), F::of(options.transmittance_min)],
        }
    }

    /// Returns a tile, and whether its list is long; see [`fn@is_long`].
    pub fn view<'a>(
        &'a self,
        tile: usize,
        inputs: &Layers<&'a [F]>,
        intersections: &'a IntersectionLists,
    ) -> (TileView<'a, F, P>, bool) {
        let origin = [tile % self.grid[0] * TILE_SIZE, tile / self.grid[0] * TILE_SIZE];
        let gaussians = &intersections.gaussian[intersections.tile_start[tile]..intersections.tile_start[tile + 1]];
        let view = TileView {
            origin,
            size: [0, 1].map(|axis| TILE_SIZE.min(self.size[axis] - origin[axis])),
            gaussians,
            slopes: self.rays.as_ref().map(|rays| (self.size[0], &rays.slopes[..])),
            footprints: &self.footprints,
            colours: if self.depth { &self.with_depth[..] } else { inputs.features },
            channels: self.channels,
            depth: self.depth,
            finite: self.finite,
        };
        (view, is_long(gaussians.len(), self.thresholds[0]))
    }
}
