//! Bounds in the picture of a lens, in the CPU twin.

use std::f64::consts::FRAC_PI_2;

use super::{DEPTH_SLOPE, EXTENT, ROUNDING};
use crate::camera::{Intrinsics, PictureRays};
use crate::linalg::norm;
use crate::project::Ellipse;
use crate::simd::real::Real;

/// Columns of a lens in a row of depth slopes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LensFrame<F> {
    /// Slopes of the centre.
    pub centre: [F; 2],
    /// `G`, px per slope, row by row.
    pub by: [[F; 2]; 2],
}

impl<F: Real> LensFrame<F> {
    /// Reads the columns of a row; `None` for a pinhole, whose rows have none.
    pub fn of(row: &[F]) -> Option<Self> {
        match row[DEPTH_SLOPE..] {
            [x, y, a, b, c, d] => Some(Self { centre: [x, y], by: [[a, b], [c, d]] }),
            _ => None,
        }
    }

    /// Returns an upper bound of the length of `G (t − t₀)` along an axis, px, for the rays of the picture.
    pub fn farthest(&self, limits: &LensLimits<F>, axis: usize) -> F {
        let far = |k: usize| (limits.high[k] - self.centre[k]).abs().max_of((self.centre[k] - limits.low[k]).abs());
        self.by[axis][0].abs() * far(0) + self.by[axis][1].abs() * far(1)
    }
}

/// What bounds need to know of a lens and its picture; [`PictureRays`] has the same fields.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LensLimits<F> {
    fisheye: bool,
    low: [F; 2],
    high: [F; 2],
    farthest: F,
    bend_px: F,
    bend_radius: F,
    stretch_px: F,
}

fn length<F: Real>([x, y]: [F; 2]) -> F {
    norm([x, y, F::ZERO])
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

    /// Returns a row that holds what the lens makes of `row`, the bounds of the Gaussian `e` without the lens's second derivative.
    /// Its opacity is zero if it misses the picture. `None` if nothing is known.
    pub fn bent(&self, row: &Ellipse<F>, e: &Ellipse<F>, frame: &LensFrame<F>) -> Option<Ellipse<F>> {
        let ([[a, b], [c, d]], centre) = (frame.by, frame.centre);
        let determinant = a * d - b * c;
        let rounding = F::of(ROUNDING) * ((a * d).abs() + (b * c).abs()) / determinant.abs();
        if !(rounding < F::of(1e-2)) {
            return None;
        }
        // The middle relative to the centre and the half-axes of the row, as slopes.
        let slopes = |[x, y]: [F; 2]| [(d * x - b * y) / determinant, (a * y - c * x) / determinant];
        let extent = F::of(EXTENT);
        let middle = slopes([row.mean_px[0] - e.mean_px[0], row.mean_px[1] - e.mean_px[1]]);
        let along = slopes([extent * row.sigma_u, extent * row.shear * row.sigma_u]);
        let across = slopes([F::ZERO, extent * row.sigma_v]);
        let farther = F::ONE + rounding;
        let reach = (length(middle) + norm([length(along), length(across), F::ZERO])) * farther;
        for k in 0..2 {
            let half = (length([along[k], across[k]]) + middle[k].abs()) * rounding + length([along[k], across[k]]);
            let slack = half + F::of(ROUNDING) * centre[k].abs();
            let at = centre[k] + middle[k];
            if at + slack < self.low[k] || at - slack > self.high[k] {
                return Some(Ellipse { opacity: F::ZERO, ..*row });
            }
        }
        let radius = length(centre);
        if !(radius <= self.bend_radius) {
            return None;
        }
        let half = F::of(0.5);
        let bend = if self.fisheye {
            let axis = if radius > F::ZERO { centre.map(|x| x / radius) } else { [F::ONE, F::ZERO] };
            let outward = |v: [F; 2]| v[0] * axis[0] + v[1] * axis[1];
            let aside = |v: [F; 2]| v[1] * axis[0] - v[0] * axis[1];
            let h_r = (outward(middle).abs() + length([outward(along), outward(across)])) * farther;
            let h_t = (aside(middle).abs() + length([aside(along), aside(across)])) * farther;
            // The direction from the axis turns along the way to the farthest point.
            let near = (radius - reach).max_of(F::of(1e-3));
            let turn = (h_t / near).min_of(F::ONE);
            let (h_r, h_t) = (h_r + h_t * turn, h_t + h_r * turn);
            let shrinking = (F::of(FRAC_PI_2) / near).min_of(F::ONE);
            let outward_bend = (F::of(2.0) / (near * near * near)).min_of(F::of(0.65));
            let turning = (F::of(FRAC_PI_2) / (near * near)).min_of(F::of(0.3));
            let of_angles = half * (outward_bend * h_r * h_r + turning * h_t * h_t) + turning * h_r * h_t;
            half * self.bend_px * (shrinking * reach) * (shrinking * reach) + self.stretch_px * of_angles
        } else {
            let reach = reach.min_of(radius + self.farthest);
            half * self.bend_px * reach * reach
        };
        let scale = a.abs() + b.abs() + c.abs() + d.abs();
        Some(wider(row, (bend + F::of(ROUNDING) * scale * radius) / extent))
    }
}

/// Returns an ellipse that holds a disc of the radius `by`, px, around every point of `row`. Of the ellipses around the sum of an
/// ellipse and a disc, it is the one with the least sum of squared half-axes.
fn wider<F: Real>(row: &Ellipse<F>, by: F) -> Ellipse<F> {
    let (u, x, v) = (row.sigma_u, row.shear * row.sigma_u, row.sigma_v);
    let squares = u * u + x * x + v * v;
    let size = (F::of(0.5) * squares).sqrt();
    let (more, extra) = (F::ONE + by / size, by * (by + size));
    let square = more * u * u + extra;
    let determinant = more * more * (u * v) * (u * v) + more * extra * squares + extra * extra;
    Ellipse { sigma_u: square.sqrt(), shear: more * u * x / square, sigma_v: (determinant / square).sqrt(), ..*row }
}
