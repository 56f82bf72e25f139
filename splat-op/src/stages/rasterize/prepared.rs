//! Preparation of the CPU twin's inputs before its loops over the tiles.

use std::borrow::Cow;
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
    pub(super) footprints: Vec<P>,
    /// Features and depth of each Gaussian if depth is rendered; otherwise nothing.
    pub(super) colours: Vec<F>,
    /// Whether all features are finite.
    pub(super) finite: bool,
    pub(super) tiles: Vec<TileTrace<F>>,
}

/// Inputs in the form that the loops over the tiles read.
pub(super) struct Prepared<'a, F: Real, P: Footprint<F>> {
    pub footprints: Cow<'a, [P]>,
    /// Features, followed by depth as one more channel if the render accumulates it.
    pub colours: Cow<'a, [F]>,
    pub channels: usize,
    /// Whether depth is the last channel.
    pub depth: bool,
    /// The rays of a camera with a lens, if Gaussians are seen along rays.
    rays: Option<Arc<PictureRays>>,
    /// Whether all colours are finite.
    pub finite: bool,
    pub grid: [usize; 2],
    pub size: [usize; 2],
    pub intersections: &'a IntersectionLists,
    pub thresholds: [F; 3],
}

/// Returns the features of each Gaussian, followed by its depth: `[N, features + 1]`.
fn with_depth<F: Real>(inputs: Layers<&[F]>, features: usize) -> Vec<F> {
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

impl<'a, F: Real, P: Footprint<F>> Prepared<'a, F, P> {
    /// `trace` is that of an earlier pass over the same inputs.
    pub fn new(
        inputs: Layers<&'a [F]>,
        spec: &RasterizeSpec,
        intersections: &'a IntersectionLists,
        trace: Option<&'a SplatTrace<F, P>>,
    ) -> Self {
        let options = &spec.options;
        let rays = if P::ALONG_RAYS { PictureRays::of(&spec.intrinsics) } else { None };
        let features = inputs.background.len();
        let colours: Cow<[F]> = match trace {
            _ if !options.depth => inputs.features.into(),
            Some(trace) => trace.colours.as_slice().into(),
            None => with_depth(inputs, features).into(),
        };
        Self {
            footprints: match trace {
                Some(trace) => trace.footprints.as_slice().into(),
                None => {
                    let lens = rays.as_ref().map(|rays| LensLimits::new(&spec.intrinsics, rays));
                    let view = FootprintView { spec, lens, boxes: &intersections.boxes };
                    footprints(&inputs, &view).into()
                }
            },
            finite: trace.map_or_else(|| is_finite(&colours), |trace| trace.finite),
            colours,
            channels: features + usize::from(options.depth),
            depth: options.depth,
            rays,
            grid: tile_grid(spec.intrinsics.width, spec.intrinsics.height),
            size: [spec.intrinsics.width, spec.intrinsics.height],
            intersections,
            thresholds: [F::of(options.alpha_min), F::of(options.alpha_max), F::of(options.transmittance_min)],
        }
    }

    /// Whether the tile's list is long; see [`fn@is_long`].
    pub fn is_long(&self, tile: usize) -> bool {
        let listed = self.intersections.tile_start[tile + 1] - self.intersections.tile_start[tile];
        is_long(listed, self.thresholds[0])
    }

    pub fn view(&self, tile: usize) -> TileView<'_, F, P> {
        let origin = [tile % self.grid[0] * TILE_SIZE, tile / self.grid[0] * TILE_SIZE];
        TileView {
            origin,
            size: [0, 1].map(|axis| TILE_SIZE.min(self.size[axis] - origin[axis])),
            gaussians: &self.intersections.gaussian
                [self.intersections.tile_start[tile]..self.intersections.tile_start[tile + 1]],
            slopes: self.rays.as_ref().map(|rays| (self.size[0], &rays.slopes[..])),
            footprints: &self.footprints,
            colours: &self.colours,
            channels: self.channels,
            depth: self.depth,
            finite: self.finite,
        }
    }
}
