//! Preparation of the CPU twin's inputs before its loops over the tiles.

use std::borrow::Cow;

use super::cpu::{CHUNK, Trace};
use super::footprint::Footprint;
use super::tile::{TileView, is_finite, is_long};
use super::{Layers, RasterizeSpec};
use crate::intersect::{IntersectionLists, TILE, tile_grid};
use crate::project::{COLUMNS, Ellipse};
use crate::simd::real::Real;
use crate::tasks;

/// Inputs in the form that the loops over the tiles read.
pub(super) struct Prepared<'a, F: Real> {
    pub footprints: Cow<'a, [Footprint<F>]>,
    /// Features, followed by depth as one more channel if the render accumulates it.
    pub colours: Cow<'a, [F]>,
    pub channels: usize,
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

/// Returns what `of` makes of each packed ellipse.
fn footprints<F: Real>(projected: &[F], of: impl Fn(&[F]) -> Footprint<F> + Sync) -> Vec<Footprint<F>> {
    let mut all = vec![Footprint::default(); projected.len() / COLUMNS];
    tasks::for_each(all.chunks_mut(CHUNK).zip(projected.chunks(COLUMNS * CHUNK)), |_, (out, rows)| {
        out.iter_mut().zip(rows.chunks_exact(COLUMNS)).for_each(|(out, row)| *out = of(row));
    });
    all
}

impl<'a, F: Real> Prepared<'a, F> {
    /// `trace` is that of an earlier pass over the same inputs.
    pub fn new(
        inputs: Layers<&'a [F]>,
        spec: &RasterizeSpec,
        intersections: &'a IntersectionLists,
        trace: Option<&'a Trace<F>>,
    ) -> Self {
        let options = &spec.options;
        let alpha_min = F::of(options.alpha_min);
        let footprint = |row: &[F]| {
            let ellipse = Ellipse::from_row(row);
            // Only Gaussians in the lists are read, and those have a positive opacity.
            if ellipse.opacity > F::ZERO { Footprint::new(&ellipse, alpha_min) } else { Footprint::default() }
        };
        let features = inputs.background.len();
        let colours: Cow<[F]> = match trace {
            _ if !options.depth => inputs.features.into(),
            Some(trace) => trace.colours.as_slice().into(),
            None => with_depth(inputs, features).into(),
        };
        Self {
            footprints: match trace {
                Some(trace) => trace.footprints.as_slice().into(),
                None => footprints(inputs.projected, footprint).into(),
            },
            finite: is_finite(&colours),
            colours,
            channels: features + usize::from(options.depth),
            grid: tile_grid(spec.intrinsics.width, spec.intrinsics.height),
            size: [spec.intrinsics.width, spec.intrinsics.height],
            intersections,
            thresholds: [alpha_min, F::of(options.alpha_max), F::of(options.transmittance_min)],
        }
    }

    /// Whether the tile's list is long; see [`fn@is_long`].
    pub fn is_long(&self, tile: usize) -> bool {
        let listed = self.intersections.tile_start[tile + 1] - self.intersections.tile_start[tile];
        is_long(listed, self.thresholds[0])
    }

    pub fn view(&self, tile: usize) -> TileView<'_, F> {
        let origin = [tile % self.grid[0] * TILE, tile / self.grid[0] * TILE];
        TileView {
            origin,
            size: [0, 1].map(|axis| TILE.min(self.size[axis] - origin[axis])),
            gaussians: &self.intersections.gaussian
                [self.intersections.tile_start[tile]..self.intersections.tile_start[tile + 1]],
            footprints: &self.footprints,
            colours: &self.colours,
            channels: self.channels,
            finite: self.finite,
        }
    }
}
