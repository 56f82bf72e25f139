//! Bounds in the picture of a lens, in the CPU twin, for eight Gaussians at a time.

use std::f64::consts::FRAC_PI_2;
use std::ops::Div;

use fearless_simd::prelude::*;

use super::{EXTENT, RAY_SPACE, ROUNDING};
use crate::camera::{Intrinsics, PictureRays};
use crate::linalg::Entry;
use crate::project::Ellipse;
use crate::simd::each;
use crate::simd::lanes::{MaskOf, norm};
use crate::simd::real::Real;

/// Columns of a lens in a row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LensFrameSimd<F> {
    /// Slopes of the centre.
    pub centre: [F; 2],
    /// `G`, px per slope, row by row.
    pub by: [[F; 2]; 2],
}

impl<F: Copy> LensFrameSimd<F> {
    /// Reads the columns of a row; `None` for a pinhole, whose rows have none.
    #[inline(always)]
    pub fn of(row: &[F]) -> Option<Self> {
        match row[RAY_SPACE..] {
            [x, y, a, b, c, d] => Some(Self { centre: [x, y], by: [[a, b], [c, d]] }),
            _ => None,
        }
    }
}

impl<F: Real> LensFrameSimd<F> {
    /// Returns an upper bound of the length of `G (t − t₀)` along an axis, px, for the rays of the picture.
    pub fn farthest(&self, limits: &LensLimitsSimd<F>, axis: usize) -> F {
        let far = |k: usize| (limits.high[k] - self.centre[k]).abs().max_of((self.centre[k] - limits.low[k]).abs());
        self.by[axis][0].abs() * far(0) + self.by[axis][1].abs() * far(1)
    }
}

/// What bounds need to know of a lens and its picture, as numbers or broadcast to all lanes; [`PictureRays`] has the same fields.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LensLimitsSimd<F> {
    fisheye: bool,
    low: [F; 2],
    high: [F; 2],
    farthest: F,
    bend_px: F,
    bend_radius: F,
    stretch_px: F,
}

impl<F: Real> LensLimitsSimd<F> {
    pub fn new(camera: &Intrinsics, rays: &PictureRays) -> Self {
        Self {
            fisheye: camera.model.is_fisheye(),
            low: rays.low.map(F::of),
            high: rays.high.map(F::of),
            farthest: F::of(rays.farthest),
            bend_px: F::of(rays.bend_px),
            bend_radius: F::of(rays.bend_radius),
            stretch_px: F::of(rays.stretch_px),
        }
    }

    #[inline(always)]
    pub fn lanes<S: Simd>(&self, simd: S) -> LensLimitsSimd<F::Lanes<S>> {
        let lanes = |value: F| F::Lanes::<S>::splat(simd, value);
        LensLimitsSimd {
            fisheye: self.fisheye,
            low: each!(self.low, |value| lanes(value)),
            high: each!(self.high, |value| lanes(value)),
            farthest: lanes(self.farthest),
            bend_px: lanes(self.bend_px),
            bend_radius: lanes(self.bend_radius),
            stretch_px: lanes(self.stretch_px),
        }
    }
}

/// Rows that hold what a lens makes of Gaussians.
pub(super) struct Bent<S: Simd, F: Real> {
    pub row: Ellipse<F::Lanes<S>>,
    /// Whether the lens gives bounds, and whether the Gaussian misses the picture.
    pub known: MaskOf<S, F>,
    pub missed: MaskOf<S, F>,
}

#[inline(always)]
fn length<S: Simd, F: Real>(simd: S, [x, y]: [F::Lanes<S>; 2]) -> F::Lanes<S> {
    norm::<S, F>(simd, [x, y, F::Lanes::<S>::splat(simd, F::ZERO)])
}

/// Returns `m⁻¹ v`.
#[inline(always)]
fn solved<L: Entry + Div<Output = L>>([[a, b], [c, d]]: [[L; 2]; 2], determinant: L, [x, y]: [L; 2]) -> [L; 2] {
    [(d * x - b * y) / determinant, (a * y - c * x) / determinant]
}

#[inline(always)]
fn dot2<L: Entry>(a: [L; 2], b: [L; 2]) -> L {
    a[0] * b[0] + a[1] * b[1]
}

#[inline(always)]
fn cross2<L: Entry>(a: [L; 2], b: [L; 2]) -> L {
    a[0] * b[1] - a[1] * b[0]
}

impl<L: Copy> LensLimitsSimd<L> {
    /// Returns rows that hold what the lens makes of `row`, the bounds of the Gaussians `e` without the lens's second derivative.
    #[inline(always)]
    pub(super) fn bent<S: Simd, F: Real<Lanes<S> = L>>(
        &self,
        simd: S,
        row: &Ellipse<L>,
        e: &Ellipse<L>,
        frame: &LensFrameSimd<L>,
    ) -> Bent<S, F>
    where
        L: SimdFloat<S, Element = F>,
    {
        let lanes = |value: f64| L::splat(simd, F::of(value));
        let (zero, one) = (lanes(0.0), lanes(1.0));
        let ([[a, b], [c, d]], centre) = (frame.by, frame.centre);
        let determinant = a * d - b * c;
        let rounding = ((a * d).abs() + (b * c).abs()) / determinant.abs() * F::of(ROUNDING);
        // The middle relative to the centre and the half-axes of the row, as slopes.
        let extent = F::of(EXTENT);
        let middle = solved(frame.by, determinant, [row.mean_px[0] - e.mean_px[0], row.mean_px[1] - e.mean_px[1]]);
        let along = solved(frame.by, determinant, [row.sigma_u * extent, row.shear * row.sigma_u * extent]);
        let across = solved(frame.by, determinant, [zero, row.sigma_v * extent]);
        let farther = one + rounding;
        let reach = (length::<S, F>(simd, middle)
            + norm::<S, F>(simd, [length::<S, F>(simd, along), length::<S, F>(simd, across), zero]))
            * farther;
        let mut missed = one.simd_lt(zero);
        for k in 0..2 {
            let half = length::<S, F>(simd, [along[k], across[k]]);
            let slack = (half + middle[k].abs()) * rounding + half + centre[k].abs() * F::of(ROUNDING);
            let at = centre[k] + middle[k];
            missed |= (at + slack).simd_lt(self.low[k]) | (at - slack).simd_gt(self.high[k]);
        }
        let radius = length::<S, F>(simd, centre);
        let known = rounding.simd_lt(lanes(1e-2)) & (radius.simd_le(self.bend_radius) | missed);
        let half = F::of(0.5);
        let bend = if self.fisheye {
            let is_off = radius.simd_gt(zero);
            let axis = [is_off.select(centre[0] / radius, one), is_off.select(centre[1] / radius, zero)];
            let h_r =
                (dot2(axis, middle).abs() + length::<S, F>(simd, [dot2(axis, along), dot2(axis, across)])) * farther;
            let h_t = (cross2(axis, middle).abs() + length::<S, F>(simd, [cross2(axis, along), cross2(axis, across)]))
                * farther;
            // The direction from the axis turns along the way to the farthest point.
            let near = (radius - reach).max(lanes(1e-3));
            let turn = (h_t / near).min(one);
            let (h_r, h_t) = (h_r + h_t * turn, h_t + h_r * turn);
            let shrinking = (lanes(FRAC_PI_2) / near).min(one);
            let outward_bend = (lanes(2.0) / (near * near * near)).min(lanes(0.65));
            let turning = (lanes(FRAC_PI_2) / (near * near)).min(lanes(0.3));
            let of_angles = (outward_bend * h_r * h_r + turning * h_t * h_t) * half + turning * h_r * h_t;
            let shrunk = shrinking * reach;
            self.bend_px * shrunk * shrunk * half + self.stretch_px * of_angles
        } else {
            let reach = reach.min(radius + self.farthest);
            self.bend_px * reach * reach * half
        };
        let scale = a.abs() + b.abs() + c.abs() + d.abs();
        let by = (bend + scale * radius * F::of(ROUNDING)) / lanes(EXTENT);
        Bent { row: wider::<S, F>(simd, row, by), known, missed }
    }
}

/// Returns ellipses that hold a disc of the radius `by`, px, around every point of `row`. Of the ellipses around the sum of an
/// ellipse and a disc, it is the one with the least sum of squared half-axes.
#[inline(always)]
fn wider<S: Simd, F: Real>(simd: S, row: &Ellipse<F::Lanes<S>>, by: F::Lanes<S>) -> Ellipse<F::Lanes<S>> {
    let (u, x, v) = (row.sigma_u, row.shear * row.sigma_u, row.sigma_v);
    let squares = u * u + x * x + v * v;
    let size = (squares * F::of(0.5)).sqrt();
    let (more, extra) = (F::Lanes::<S>::splat(simd, F::ONE) + by / size, by * (by + size));
    let square = more * u * u + extra;
    let determinant = more * more * (u * v) * (u * v) + more * extra * squares + extra * extra;
    Ellipse { sigma_u: square.sqrt(), shear: more * u * x / square, sigma_v: (determinant / square).sqrt(), ..*row }
}
