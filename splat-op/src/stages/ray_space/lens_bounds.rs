//! Bounds in the picture of a lens, for the kernels and the CPU twin.

use std::f64::consts::FRAC_PI_2;

use super::{EXTENT, RAY_SPACE, ROUNDING};
use crate::camera::{Intrinsics, PictureRays};
use crate::linalg::{Number, dot2};
use crate::project::Ellipse;
use crate::simd::{Real, each};

/// A row for `intersect`, whether it is known to hold all that shows, and whether nothing shows.
pub(super) struct Bounded<N: Number> {
    pub row: Ellipse<N>,
    pub known: N::Mask,
    pub hidden: N::Mask,
}

/// Columns of a lens in a row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LensFrame<N> {
    /// Slopes of the centre.
    pub centre: [N; 2],
    /// `G`, px per slope, row by row.
    pub by: [[N; 2]; 2],
}

impl<N: Copy> LensFrame<N> {
    /// Reads the columns of a row; `None` for a pinhole, whose rows have none.
    #[inline(always)]
    pub fn of(row: &[N]) -> Option<Self> {
        match row[RAY_SPACE..] {
            [x, y, a, b, c, d] => Some(Self { centre: [x, y], by: [[a, b], [c, d]] }),
            _ => None,
        }
    }
}

impl<F: Real> LensFrame<F> {
    /// Returns an upper bound of the length of `G (t − t₀)` along an axis, px, for the rays of the picture.
    pub fn farthest(&self, limits: &LensLimits<F>, axis: usize) -> F {
        let far = |k: usize| (limits.high[k] - self.centre[k]).abs().max_of((self.centre[k] - limits.low[k]).abs());
        self.by[axis][0].abs() * far(0) + self.by[axis][1].abs() * far(1)
    }
}

/// What bounds need to know of a lens and its picture; [`PictureRays`] has the same fields.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LensLimits<N> {
    pub fisheye: bool,
    pub low: [N; 2],
    pub high: [N; 2],
    pub farthest: N,
    pub bend_px: N,
    pub bend_radius: N,
    pub stretch_px: N,
}

impl<F: Real> LensLimits<F> {
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
}

/// Returns `m⁻¹ v`.
#[inline(always)]
fn solved<N: Number>([[a, b], [c, d]]: [[N; 2]; 2], inverse: N, [x, y]: [N; 2]) -> [N; 2] {
    [(d * x - b * y) * inverse, (a * y - c * x) * inverse]
}

impl<N: Number> LensLimits<N> {
    /// Returns the row that holds what the lens makes of `row`, the bounds of the Gaussian `e` without the lens's second derivative.
    #[inline(always)]
    pub(super) fn bent(&self, row: &Ellipse<N>, e: &Ellipse<N>, frame: &LensFrame<N>) -> Bounded<N> {
        let (zero, one) = (e.depth.constant(0.0), e.depth.constant(1.0));
        let ([[a, b], [c, d]], centre) = (frame.by, frame.centre);
        let determinant = a * d - b * c;
        let rounding = ((a * d).abs() + (b * c).abs()) * ROUNDING / determinant.abs();
        let apart = rounding.finite() & rounding.lt(one.constant(1e-2));
        // The middle relative to the centre and the half-axes of the row, as slopes.
        let inverse = one / determinant;
        let middle = solved(frame.by, inverse, [row.mean_px[0] - e.mean_px[0], row.mean_px[1] - e.mean_px[1]]);
        let along = solved(frame.by, inverse, [row.sigma_u * EXTENT, row.shear * row.sigma_u * EXTENT]);
        let across = row.sigma_v * EXTENT;
        let across = [-(b * across) * inverse, a * across * inverse];
        let farther = rounding + 1.0;
        let sides = along[0].hypotenuse(along[1]).hypotenuse(across[0].hypotenuse(across[1]));
        let reach = (middle[0].hypotenuse(middle[1]) + sides) * farther;
        let misses = each!([0, 1], |k| {
            let half = along[k].hypotenuse(across[k]);
            let slack = (half + middle[k].abs()) * rounding + half + centre[k].abs() * ROUNDING;
            let at = centre[k] + middle[k];
            (at + slack).lt(self.low[k]) | (at - slack).gt(self.high[k])
        });
        let radius = centre[0].hypotenuse(centre[1]);
        let bend = if self.fisheye {
            let beside = radius.gt(zero);
            let axis = [N::ratio(beside, centre[0], radius, 1.0), N::ratio(beside, centre[1], radius, 0.0)];
            let aside = [-axis[1], axis[0]];
            let [h_r, h_t] = each!([axis, aside], |axis| {
                (dot2(middle, axis).abs() + dot2(along, axis).hypotenuse(dot2(across, axis))) * farther
            });
            // The direction from the axis turns along the way to the farthest point.
            let near = (radius - reach).max(one.constant(1e-3));
            let turn = (h_t / near).min(one);
            let (h_r, h_t) = (h_r + h_t * turn, h_t + h_r * turn);
            let half_turn = one.constant(FRAC_PI_2);
            let shrunk = (half_turn / near).min(one) * reach;
            let outward_bend = (one.constant(2.0) / (near * near * near)).min(one.constant(0.65));
            let turning = (half_turn / (near * near)).min(one.constant(0.3));
            let of_angles = (outward_bend * h_r * h_r + turning * h_t * h_t) * 0.5 + turning * h_r * h_t;
            self.bend_px * 0.5 * shrunk * shrunk + self.stretch_px * of_angles
        } else {
            let reach = reach.min(radius + self.farthest);
            self.bend_px * 0.5 * reach * reach
        };
        let scale = a.abs() + b.abs() + c.abs() + d.abs();
        let by = (bend + scale * radius * ROUNDING) * (1.0 / EXTENT);
        Bounded {
            row: wider(row, by),
            known: apart & by.finite() & radius.le(self.bend_radius),
            hidden: apart & (misses[0] | misses[1]),
        }
    }
}

/// Returns an ellipse that holds a disc of the radius `by`, px, around every point of `row`. Of the ellipses around the sum of an
/// ellipse and a disc, it is the one with the least sum of squared half-axes.
#[inline(always)]
fn wider<N: Number>(row: &Ellipse<N>, by: N) -> Ellipse<N> {
    let (u, x, v) = (row.sigma_u, row.shear * row.sigma_u, row.sigma_v);
    let squares = u * u + x * x + v * v;
    let size = (squares * 0.5).sqrt();
    let (more, extra) = (by / size + 1.0, by * (by + size));
    let square = more * u * u + extra;
    let area = u * v;
    let determinant = more * more * area * area + more * extra * squares + extra * extra;
    Ellipse { sigma_u: square.sqrt(), shear: more * u * x / square, sigma_v: (determinant / square).sqrt(), ..*row }
}
