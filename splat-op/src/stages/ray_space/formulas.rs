//! The formulas of the module's documentation, for the kernels and the CPU twin. Values of culled Gaussians are meaningless; both mask these.

use super::{DEPTH_SLOPE, LensFrame, RAY_SPACE, THICKNESS_MAX};
use crate::linalg::{Matrix3, Number, add, cross, dot, hadamard, scale, sub};
use crate::simd::each;

/// What `project` finds of a Gaussian, with the names of its documentation.
pub(super) struct Factored<N> {
    pub n: [N; 3],
    pub along: [N; 3],
    pub p: [N; 3],
    pub sigma_u: N,
    pub shear: N,
    pub sigma_v: N,
    /// The last row of `W R`.
    pub last: [N; 3],
    pub depth: N,
    pub scale: [N; 3],
    pub blur_sigma: N,
}

/// Intermediate values of the forward pass, with the names of the module's documentation.
pub(super) struct RaySpaceTerms<N: Number> {
    f: Factored<N>,
    inverse_z: N,
    /// `mz`, and without the scales.
    mz: [N; 3],
    jz: [N; 3],
    length: N,
    b_u: N,
    b: N,
    p: [N; 3],
    a: [N; 3],
    c: [N; 3],
    depth_slope: [N; DEPTH_SLOPE],
    /// Whether the thickness is not clamped.
    free: N::Mask,
    /// False if the Gaussian is too long for a depth slope.
    sound: N::Mask,
}

/// Gradients of the scales, of `W R` and of the centre in the camera's frame, and `B₀₀, B₀₁, B₁₁`.
pub(super) struct RaySpaceGrad<N> {
    pub scales: [N; 3],
    pub rows: Matrix3<N>,
    pub centre: [N; 3],
    pub blur: [N; 3],
}

/// Gradients of the rows of `m`, and `B₀₀, B₀₁, B₁₁`.
struct RowsGrad<N> {
    m: Matrix3<N>,
    blur: [N; 3],
}

impl<N: Number> RaySpaceTerms<N> {
    #[inline(always)]
    pub fn new(f: Factored<N>) -> Self {
        let one = f.depth.constant(1.0);
        let inverse_z = one / f.depth;
        let jz = scale(f.last, inverse_z);
        let mz = hadamard(jz, f.scale);
        let inverse_v = one / f.sigma_v;
        let (b_u, b) = (f.blur_sigma / f.sigma_u, f.blur_sigma * inverse_v);
        let (p, a) = (scale(f.p, inverse_v), scale(f.along, b));
        let c = cross(f.n, mz);
        let length = N::length(mz);
        let rest = N::length(cross(a, mz)).hypotenuse(b * b_u * length);
        let thickness = N::length([dot(mz, p), b * N::length(c), rest]);
        let depth_slope = [dot(mz, f.n), dot(p, c) + b_u * dot(a, mz), thickness.min(one.constant(THICKNESS_MAX))];
        let finite = depth_slope[0].finite() & depth_slope[1].finite() & thickness.finite();
        let free = depth_slope[2].eq(thickness);
        let sound = length.le(one.constant(1e30)) & finite;
        Self { f, inverse_z, mz, jz, length, b_u, b, p, a, c, depth_slope, free, sound }
    }

    /// Returns the row of a Gaussian that is `seen`, `away` px from the origin, without the columns of a lens; zero if it is not seen.
    #[inline(always)]
    pub fn row(&self, seen: N::Mask, away: [N; 2]) -> [N; RAY_SPACE] {
        let (f, zero) = (&self.f, self.length.constant(0.0));
        let [slope_u, slope_v, thickness] = N::select_all(seen & self.sound, self.depth_slope, [zero; DEPTH_SLOPE]);
        let place = [zero.constant(1.0), away[0], away[1]];
        let [depth, away_x, away_y] = N::select_all(seen, place, [zero; 3]);
        let [sigma_u, shear, sigma_v] = N::select_all(seen, [f.sigma_u, f.shear, f.sigma_v], [zero; 3]);
        [slope_u, slope_v, thickness, depth, away_x, away_y, sigma_u, shear, sigma_v]
    }

    /// Returns the gradients of the rows of `m`, and of the blur times the blur, from that of a row.
    #[inline(always)]
    fn factor_backward(&self, grad: &[N]) -> RowsGrad<N> {
        let Self { mz, length, b_u, p, a, b, c, sound, .. } = *self;
        let Factored { n, sigma_u, shear, sigma_v, blur_sigma, .. } = self.f;
        let (zero, one) = (length.constant(0.0), length.constant(1.0));
        let (inverse_u, inverse_v) = (one / sigma_u, one / sigma_v);
        // The rows of `N`, each at most of length one. The last one is zero where the thickness is clamped or the row was set to zero.
        let across = add(cross(p, n), scale(a, b_u));
        let free = self.free & sound & self.depth_slope[2].gt(zero);
        let inverse = N::ratio(free, one, self.depth_slope[2], 0.0);
        let through = add(scale(p, dot(mz, p) * inverse), scale(cross(scale(c, b * inverse), n), b));
        let through = add(through, cross(scale(cross(a, mz), inverse), a));
        let of_length = scale(mz, N::ratio(length.gt(zero), one, length, 0.0));
        let rest = b * b_u * length * inverse;
        let through = N::select_all(free, add(through, scale(of_length, rest * b * b_u)), [zero; 3]);

        let [of_u, of_v] = N::select_all(sound, [grad[0], grad[1]], [zero; 2]);
        let [slope_u, slope_v] = N::select_all(sound, [self.depth_slope[0], self.depth_slope[1]], [zero; 2]);
        let [of_t, thickness] = N::select_all(free, [grad[2], self.depth_slope[2]], [zero; 2]);
        let (of_sigma_u, of_shear, of_sigma_v) = (grad[6], grad[7], grad[8]);
        // The gradients of `m0` and `m1` in terms of the rows of `N`.
        let lean = of_shear * inverse_u;
        let turned = (of_v * thickness - of_t * slope_v) * inverse_v;
        let first = [
            of_sigma_u - lean * shear,
            (lean * sigma_v + (of_u * slope_v - of_v * slope_u)) * inverse_u - of_sigma_v * shear,
            (of_u * thickness - of_t * slope_u) * inverse_u - turned * shear,
        ];
        let second = [lean, of_sigma_v, turned];
        // The components of the rows of `N` along the blur of x and of y.
        let across_x = -(shear * b);
        let through_blur = [(slope_v * shear * b - slope_u * b_u) * inverse, -(slope_v * b) * inverse];
        RowsGrad {
            m: each!([first, second, [of_u, of_v, of_t]], |of| {
                add(add(scale(n, of[0]), scale(across, of[1])), scale(through, of[2]))
            }),
            blur: [
                blur_sigma * (first[0] * b_u + first[1] * across_x + first[2] * through_blur[0]),
                blur_sigma * (first[1] * b + first[2] * through_blur[1]),
                blur_sigma * (second[1] * b + second[2] * through_blur[1]),
            ],
        }
    }

    /// Returns the gradients from that of a row. `j` are the rows of `J W R`, and `map` is held fixed.
    #[inline(always)]
    pub fn backward(&self, j: [[N; 3]; 2], map: &LensFrame<N>, grad: &[N]) -> RaySpaceGrad<N> {
        let RowsGrad { m: grad_m, blur } = self.factor_backward(grad);
        let scales = add(hadamard(grad_m[0], j[0]), hadamard(grad_m[1], j[1]));
        let scales = add(scales, hadamard(grad_m[2], self.jz));
        let [grad_j0, grad_j1, grad_jz] = each!(grad_m, |row| hadamard(row, self.f.scale));
        // `J` has the rows `G (1, −t) / z` and `(0, 0, 1) / z`, and a centre moves in the picture by the former.
        let zero = self.length.constant(0.0);
        let mut rows = [[zero; 3], [zero; 3], scale(grad_jz, self.inverse_z)];
        let mut centre = [zero, zero, (grad[3] + blur[0] + blur[2]) * self.inverse_z];
        for axis in 0..2 {
            let [by_x, by_y] = [map.by[0][axis] * self.inverse_z, map.by[1][axis] * self.inverse_z];
            rows[axis] = add(scale(grad_j0, by_x), scale(grad_j1, by_y));
            rows[2] = sub(rows[2], scale(rows[axis], map.centre[axis]));
            centre[axis] = grad[4] * by_x + grad[5] * by_y;
            centre[2] = centre[2] - centre[axis] * map.centre[axis];
        }
        RaySpaceGrad { scales, rows, centre, blur }
    }
}

impl<N: Number> LensFrame<N> {
    /// Returns the columns of a lens for a centre in the camera's frame at which its Jacobian has these rows.
    #[inline(always)]
    pub(super) fn at([x, y, z]: [N; 3], jacobian: &[[N; 3]; 2]) -> Self {
        Self { centre: [x / z, y / z], by: each!([0, 1], |row| [jacobian[row][0] * z, jacobian[row][1] * z]) }
    }

    #[inline(always)]
    pub(super) fn to_row(self) -> [N; 6] {
        let Self { centre: [x, y], by: [[a, b], [c, d]] } = self;
        [x, y, a, b, c, d]
    }

    /// Returns the gradient of the lens's Jacobian at the depth `z`, and its share of that of the depth. The blur alone depends on
    /// `G`, whose gradient is `−B G⁻ᵀ`.
    #[inline(always)]
    pub(super) fn backward(&self, z: N, jacobian: &[[N; 3]; 2], blur: [N; 3]) -> ([[N; 3]; 2], N) {
        let ([[a, b], [c, d]], zero) = (self.by, z.constant(0.0));
        let scaled = -z / (a * d - b * c);
        let of_jacobian = each!([[blur[0], blur[1]], [blur[1], blur[2]]], |[of_x, of_y]| {
            [(of_x * d - of_y * b) * scaled, (of_y * a - of_x * c) * scaled, zero]
        });
        let of_z = each!([0, 1], |axis| {
            of_jacobian[axis][0] * jacobian[axis][0] + of_jacobian[axis][1] * jacobian[axis][1]
        });
        (of_jacobian, (of_z[0] + of_z[1]) / z)
    }
}
