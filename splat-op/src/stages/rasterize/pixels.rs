//! The pixels of a tile in the CPU twin: their order, and what a Gaussian is evaluated at.

use fearless_simd::prelude::*;

use crate::camera::LEAST_NO_RAY;
use crate::intersect::{TILE_PIXELS, TILE_SIZE};
use crate::simd::real::Real;

/// Number of pixels along a row of a block.
pub(crate) const SIMD_WIDTH: usize = 4;

/// Number of rows of a block. The widest SIMD vectors hold a block's 16 pixels; narrower ones hold a part of it.
pub(crate) const SIMD_ROWS: usize = 4;

/// Number of pixels in a block of a tile.
pub(crate) const SIMD_BLOCK: usize = SIMD_WIDTH * SIMD_ROWS;

/// Number of pixels in a row of blocks.
pub(crate) const SIMD_BLOCK_ROW: usize = SIMD_ROWS * TILE_SIZE;

/// One value for each pixel of a tile: block by block, within a block row by row. The blocks run along x, then y.
pub(crate) type Plane<F> = [F; TILE_PIXELS];

/// Brings values in the order of a tile's blocks into the order of its rows.
#[inline(always)]
pub(super) fn in_rows<F: Real>(plane: &Plane<F>) -> Plane<F> {
    let mut rows = [F::ZERO; TILE_PIXELS];
    for (four, values) in rows.as_chunks_mut::<SIMD_WIDTH>().0.iter_mut().enumerate() {
        *values = plane.as_chunks::<SIMD_WIDTH>().0[in_block_order(four)];
    }
    rows
}

/// Returns the place, in the order of blocks, of the four pixels at place `four` in the order of rows.
pub(super) const fn in_block_order(four: usize) -> usize {
    let (row, column) = (four / (TILE_SIZE / SIMD_WIDTH), four % (TILE_SIZE / SIMD_WIDTH));
    (row / SIMD_ROWS * (TILE_SIZE / SIMD_WIDTH) + column) * SIMD_ROWS + row % SIMD_ROWS
}

/// Returns the row and the column in the tile of the pixel at a place.
pub(super) const fn row_and_column(place: usize) -> [usize; 2] {
    let (block, row) = (place / SIMD_BLOCK, place % SIMD_BLOCK / SIMD_WIDTH);
    let across = TILE_SIZE / SIMD_WIDTH;
    [block / across * SIMD_ROWS + row, block % across * SIMD_WIDTH + place % SIMD_WIDTH]
}

/// Number of lanes of a vector of pixels.
#[inline(always)]
pub(crate) const fn len<S: Simd, F: Real>() -> usize {
    <F::Block<S> as SimdBase<S>>::LEN
}

/// Returns a vector of pixels from `place` on, a multiple of its length.
#[inline(always)]
pub(crate) fn lanes<S: Simd, F: Real>(simd: S, plane: &[F], place: usize) -> F::Block<S> {
    F::Block::<S>::from_slice(simd, &plane[place..place + len::<S, F>()])
}

#[inline(always)]
pub(crate) fn store<S: Simd, L: SimdFloat<S>>(lanes: L, plane: &mut [L::Element], place: usize) {
    lanes.store_slice(&mut plane[place..place + L::LEN]);
}

/// The pixels of a tile.
pub(crate) struct TilePixels<F> {
    /// Centres along x of a row of blocks, px.
    x: [F; SIMD_BLOCK_ROW],
    /// Centre of the first row, px.
    pub top: F,
    /// The row of each pixel.
    rows: Plane<F>,
    /// Slopes of the pixels' rays, if Gaussians are seen along rays through a lens.
    pub slopes: Option<Box<[Plane<F>; 2]>>,
    /// Transmittances in front of all layers: one where a pixel is in the picture and has a ray, finished elsewhere.
    pub open: Plane<F>,
}

impl<F: Real> TilePixels<F> {
    #[inline(always)]
    pub fn new<P>(view: &TileView<F, P>) -> Self {
        let [left, top] = view.corner();
        let mut pixels = Self {
            x: [left; SIMD_BLOCK_ROW],
            top: top + F::of(0.5),
            rows: [F::ZERO; TILE_PIXELS],
            slopes: None,
            open: [-F::ONE; TILE_PIXELS],
        };
        for place in 0..TILE_PIXELS {
            let [row, column] = row_and_column(place);
            pixels.rows[place] = F::of(row as f64);
            if place < SIMD_BLOCK_ROW {
                pixels.x[place] += F::of(column as f64 + 0.5);
            }
            if row < view.size[1] && column < view.size[0] {
                pixels.open[place] = F::ONE;
            }
        }
        if let Some((width, slopes)) = view.slopes {
            pixels.read_slopes(view.origin, view.size, width, slopes);
        }
        pixels
    }

    /// Reads the slopes of the pixels' rays. A pixel without a ray sees nothing, like one outside the picture.
    fn read_slopes(&mut self, origin: [usize; 2], size: [usize; 2], width: usize, slopes: &[[f64; 2]]) {
        let mut planes = Box::new([[F::ZERO; TILE_PIXELS]; 2]);
        for row in 0..size[1] {
            let slopes = &slopes[(origin[1] + row) * width + origin[0]..][..size[0]];
            for (four, slopes) in slopes.chunks(SIMD_WIDTH).enumerate() {
                let first = in_block_order(row * (TILE_SIZE / SIMD_WIDTH) + four) * SIMD_WIDTH;
                for (at, slope) in (first..).zip(slopes) {
                    let sees = slope[0] < LEAST_NO_RAY;
                    planes[0][at] = F::of(if sees { slope[0] } else { 0.0 });
                    planes[1][at] = F::of(if sees { slope[1] } else { 0.0 });
                    self.open[at] = if sees { self.open[at] } else { -F::ONE };
                }
            }
        }
        self.slopes = Some(planes);
    }

    /// Centres along x of a vector of pixels of a row of blocks, px.
    #[inline(always)]
    pub fn x<S: Simd>(&self, simd: S, place: usize) -> F::Block<S> {
        lanes(simd, &self.x, place)
    }

    /// Rows of a vector of pixels.
    #[inline(always)]
    pub fn rows<S: Simd>(&self, simd: S, place: usize) -> F::Block<S> {
        lanes(simd, &self.rows, place)
    }
}

/// Position of a tile and the Gaussians that it lists.
#[derive(Clone, Copy)]
pub(crate) struct TileView<'a, F, P> {
    /// First pixel of the tile.
    pub origin: [usize; 2],
    /// Number of the tile's pixels inside the picture along x and y.
    pub size: [usize; 2],
    /// Gaussians of the tile's intersections, front to back.
    pub gaussians: &'a [u32],
    /// Width of the picture, px, and the slopes of its rays, if Gaussians are seen along rays through a lens.
    pub slopes: Option<(usize, &'a [[f64; 2]])>,
    /// Footprint of each Gaussian.
    pub footprints: &'a [P],
    /// `[N, channels]`: colours of each Gaussian.
    pub colours: &'a [F],
    pub channels: usize,
    /// Whether depth is the last channel.
    pub depth: bool,
    /// Whether all colours of all Gaussians are finite.
    pub finite: bool,
}

impl<F: Real, P> TileView<'_, F, P> {
    #[inline(always)]
    pub fn corner(&self) -> [F; 2] {
        self.origin.map(|px| F::of(px as f64))
    }

    /// Number of pixels with this transmittance that are not finished.
    #[inline(always)]
    pub fn open(&self, transmittance: &Plane<F>) -> usize {
        match self.slopes {
            None => self.size[0] * self.size[1],
            Some(_) => transmittance.iter().filter(|t| **t > F::ZERO).count(),
        }
    }

    #[inline(always)]
    pub fn colour(&self, gaussian: u32) -> &[F] {
        let first = gaussian as usize * self.channels;
        &self.colours[first..first + self.channels]
    }
}
