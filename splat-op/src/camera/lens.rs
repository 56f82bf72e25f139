//! Lenses on the host, in f64: projection, its inverse, and the domain of a lens.
//!
//! A polynomial that describes a lens well within its picture has a turning point somewhere outside, and folds points beyond it
//! back into the picture. The radius up to which it is valid follows from the Jacobian of the planar map `s → d` of
//! [`CameraModel`]. Its symmetric part has the eigenvalues `g` and `(r g)'`, `r = |s|`, of the radial part, to which the
//! tangential part `2(P·s)I + 2sPᵀ + 2Psᵀ` adds at least `−6|P|r` and the prism's `Ssᵀ + sSᵀ` at least `−2|S|r`. As long as
//!
//! ```text
//! min(g, (r g)') > (6|P| + 2|S|) r
//! ```
//!
//! holds, the symmetric part is positive definite. A map whose Jacobian has this property all over a disc is one to one there (the
//! displacement of two points along the line between them is positive). The [radius of a lens's domain](Intrinsics::max_radius) is
//! that of the largest such disc; it is a root of a polynomial. Points at or beyond it are not drawn.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat2, DVec2, DVec3};

use super::{CameraModel, Intrinsics};

/// Largest slope or angle that is considered: a slope of a million is a microradian from the image plane.
pub(super) const FAR: f64 = 1e6;

/// Number of points on each border of a picture from which its extent in slopes is computed.
const BORDER_POINTS: usize = 8;

/// Coefficients of the planar map under their names in the equations; zero if the model has none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct LensCoefficients {
    /// `g = (1 + Σ radialᵢ wⁱ⁺¹) / (1 + Σ denominatorᵢ wⁱ⁺¹)`.
    pub radial: [f64; 4],
    pub denominator: [f64; 3],
    /// `P = (p2, p1)`.
    pub tangential: [f64; 2],
    /// `S = (sx1, sy1)`.
    pub prism: [f64; 2],
}

impl LensCoefficients {
    /// `g(w)` and `g'(w)`.
    fn radial(&self, w: f64) -> [f64; 2] {
        let [n, n_slope] = with_slope(&self.radial, w);
        let [d, d_slope] = with_slope(&self.denominator, w);
        let g = n / d;
        [g, (n_slope - g * d_slope) / d]
    }

    /// The tangential and prism part of the map, `2 (P·s) s + (P + S) w`.
    fn decentred(&self, s: DVec2) -> DVec2 {
        let (tangential, prism) = (DVec2::from_array(self.tangential), DVec2::from_array(self.prism));
        s * (2.0 * tangential.dot(s)) + (tangential + prism) * s.length_squared()
    }

    fn map(&self, s: DVec2) -> DVec2 {
        s * self.radial(s.length_squared())[0] + self.decentred(s)
    }

    /// The Jacobian of the map.
    fn jacobian(&self, s: DVec2) -> DMat2 {
        let (tangential, prism) = (DVec2::from_array(self.tangential), DVec2::from_array(self.prism));
        let [g, slope] = self.radial(s.length_squared());
        let outer = |a: DVec2, b: DVec2| DMat2::from_cols(a * b.x, a * b.y);
        DMat2::from_diagonal(DVec2::splat(g + 2.0 * tangential.dot(s)))
            + (outer(s, slope * s + tangential) + outer(tangential + prism, s)) * 2.0
    }

    /// Bounds of the map's Jacobian and of its second derivative, per length of the direction, at the radius `r`.
    fn steepness(&self, r: f64) -> [f64; 2] {
        let w = r * r;
        let [n, n_slope, n_bend] = with_slopes(&self.radial, w);
        let [d, d_slope, d_bend] = with_slopes(&self.denominator, w);
        let g = n / d;
        let slope = (n_slope - g * d_slope) / d;
        let bend = (n_bend - 2.0 * slope * d_slope - g * d_bend) / d;
        let norm = |v: [f64; 2]| DVec2::from_array(v).length();
        let decentred = 6.0 * norm(self.tangential) + 2.0 * norm(self.prism);
        [g.abs() + 2.0 * w * slope.abs() + decentred * r, 6.0 * r * slope.abs() + 4.0 * r * w * bend.abs() + decentred]
    }

    /// Upper bounds of [`Self::steepness`] up to the radius `r`, from samples.
    pub fn steepest(&self, r: f64) -> [f64; 2] {
        const SAMPLES: usize = 1000;
        let samples = (0..=SAMPLES).map(|i| self.steepness(r * i as f64 / SAMPLES as f64));
        // The polynomials vary little between two samples.
        samples.fold([0.0_f64; 2], |most, at| [0, 1].map(|k| most[k].max(1.1 * at[k])))
    }

    /// The `s` closer to the axis than `max_radius` whose image is `d`; `None` if there is none. `start` is a first guess.
    pub fn inverse_within(&self, d: DVec2, max_radius: f64, start: DVec2) -> Option<DVec2> {
        let polished = |start: DVec2| {
            let mut s = start;
            let mut error = self.map(s) - d;
            for _ in 0..10 {
                let next = s - self.jacobian(s).inverse() * error;
                let left = self.map(next) - d;
                if !(left.length_squared() < error.length_squared()) {
                    break;
                }
                (s, error) = (next, left);
            }
            (error.length() <= 1e-12 * (1.0 + d.length()) && s.length() < max_radius).then_some(s)
        };
        // The map is one to one within the domain, so every solution there is the only one.
        polished(start).or_else(|| polished(self.inverse(d, max_radius)))
    }

    /// Radius up to which the map is one to one; infinite if it is one to one up to [`FAR`].
    fn max_radius(&self) -> f64 {
        let norm = |v: [f64; 2]| DVec2::from_array(v).length();
        let slack = [0.0, 6.0 * norm(self.tangential) + 2.0 * norm(self.prism)];
        // All terms are multiplied by the square of the denominator `D`, as polynomials of the radius.
        let (n, d) = (even(&self.radial), even(&self.denominator));
        let allowed = times(&slack, &times(&d, &d));
        let across = minus(&times(&n, &d), &allowed);
        // (r N/D)' D² = N D + r (N' D − N D')
        let turn = minus(&times(&derivative(&n), &d), &times(&n, &derivative(&d)));
        let along = minus(&plus(&times(&n, &d), &times(&[0.0, 1.0], &turn)), &allowed);
        let first = |p: &[f64]| positive_roots(p).first().copied().unwrap_or(f64::INFINITY);
        first(&d).min(first(&across)).min(first(&along))
    }

    /// Radius whose image `r g` is `target`, at most `max_radius`. Newton's method within a bracket, which stays valid because `r g`
    /// is monotonic.
    fn radius(&self, target: f64, max_radius: f64) -> f64 {
        let (mut low, mut high) = (0.0, max_radius.min(FAR));
        let image = |r: f64| r * self.radial(r * r)[0];
        if !(image(high) > target) {
            return high;
        }
        let mut r = target.min(high);
        for _ in 0..60 {
            let [g, slope] = self.radial(r * r);
            let error = r * g - target;
            if error > 0.0 {
                high = r
            } else {
                low = r
            }
            let newton = r - error / (g + 2.0 * r * r * slope);
            let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
            if (next - r).abs() <= 1e-15 * r {
                return next;
            }
            r = next;
        }
        r
    }

    /// The `s` within the domain whose image is `d`, or one on its rim if there is none. The radial part is inverted exactly; the
    /// decentring part, which is the weaker one within the domain, by iteration.
    fn inverse(&self, d: DVec2, max_radius: f64) -> DVec2 {
        let mut s = DVec2::ZERO;
        for _ in 0..100 {
            let target = d - self.decentred(s);
            let length = target.length();
            let next = if length > 0.0 { target * (self.radius(length, max_radius) / length) } else { DVec2::ZERO };
            let step = next.distance(s);
            s = next;
            if step <= 1e-14 * s.length() {
                break;
            }
        }
        s
    }
}

/// Projects points to pixels and pixels to rays on the host, in f64; see [`Intrinsics::projector`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projector {
    camera: Intrinsics,
    lens: LensCoefficients,
    max_radius: f64,
}

impl Projector {
    /// Projects a point of the camera's frame to a position on the image plane, px; it may lie outside the picture.
    ///
    /// Returns `None` if the point is not in front of the camera or is outside the lens's domain (see
    /// [`Intrinsics::max_radius`]). The equations are [`CameraModel`]'s.
    pub fn px_from_cam(&self, point: DVec3) -> Option<DVec2> {
        let (camera, across) = (&self.camera, point.truncate());
        let s = match camera.model {
            CameraModel::Orthographic => across,
            CameraModel::Fisheye | CameraModel::ThinPrismFisheye => {
                let rho = across.length();
                // On the axis angles equal slopes.
                across * if rho > 0.0 { rho.atan2(point.z) / rho } else { 1.0 / point.z }
            }
            _ => across / point.z,
        };
        let seen = point.z > 0.0 && s.length() < self.max_radius;
        let d = self.lens.map(s);
        seen.then(|| DVec2::new(camera.fx * d.x + camera.cx, camera.fy * d.y + camera.cy))
    }

    /// Returns the direction, in the camera's frame, that projects to the position `px`, px.
    ///
    /// Its z is one. For a fisheye, whose picture may include directions with a z of zero, its length is one instead. If no
    /// direction projects to `px`, it is the nearest one in the lens's domain. An orthographic camera's is the z axis everywhere.
    pub fn cam_from_px(&self, px: DVec2) -> DVec3 {
        let d = self.camera.focal_from_px(px);
        let model = self.camera.model;
        match model {
            CameraModel::Pinhole => return d.extend(1.0),
            CameraModel::Orthographic => return DVec3::Z,
            _ => {}
        }
        if !model.is_fisheye() {
            return self.lens.inverse(d, self.max_radius).extend(1.0);
        }
        let s = self.lens.inverse(d, self.max_radius.min(FRAC_PI_2));
        let angle = s.length();
        if angle > 0.0 { (s * (angle.sin() / angle)).extend(angle.cos()) } else { DVec3::Z }
    }
}

impl Intrinsics {
    pub(crate) fn coefficients(&self) -> LensCoefficients {
        let [a, b, c, d, e, f, g, h] = self.distortion;
        let none = LensCoefficients::default();
        match self.model {
            CameraModel::Pinhole | CameraModel::Orthographic => none,
            CameraModel::OpenCv => LensCoefficients { radial: [a, b, 0.0, 0.0], tangential: [d, c], ..none },
            CameraModel::FullOpenCv => {
                LensCoefficients { radial: [a, b, e, 0.0], denominator: [f, g, h], tangential: [d, c], ..none }
            }
            CameraModel::Fisheye => LensCoefficients { radial: [a, b, c, d], ..none },
            CameraModel::ThinPrismFisheye => {
                LensCoefficients { radial: [a, b, e, f], tangential: [d, c], prism: [g, h], ..none }
            }
        }
    }

    /// Returns the radius of the lens's domain: a slope, or for a fisheye an angle in radians.
    ///
    /// Below it no two directions project to the same position; the lens shows nothing from there on. It is infinite if
    /// that holds up to a slope of a million, as for a pinhole, and for an orthographic camera.
    pub fn max_radius(&self) -> f64 {
        self.coefficients().max_radius()
    }

    /// Slopes `[low, high]` along x and y to which the Jacobian's slopes are clamped: the picture's extent and `margin` times half of
    /// it on either side. A lens's picture has the extent of its border in slopes, widened to include the optical axis, so that
    /// clamping never moves a slope outwards.
    pub(crate) fn slope_limits(&self, margin: f64) -> [[f64; 2]; 2] {
        // Those of an orthographic camera, whose Jacobian is constant, are not used.
        if matches!(self.model, CameraModel::Pinhole | CameraModel::Orthographic) {
            let limits = |size: usize, focal: f64, principal: f64| {
                let margin = margin * size as f64 / (2.0 * focal);
                [-principal / focal - margin, (size as f64 - principal) / focal + margin]
            };
            return [limits(self.width, self.fx, self.cx), limits(self.height, self.fy, self.cy)];
        }
        let (lens, size) = (self.coefficients(), DVec2::new(self.width as f64, self.height as f64));
        let max_radius = lens.max_radius();
        let (mut low, mut high) = (DVec2::ZERO, DVec2::ZERO);
        for i in 0..=BORDER_POINTS {
            let along = i as f64 / BORDER_POINTS as f64;
            for share in [(along, 0.0), (along, 1.0), (0.0, along), (1.0, along)] {
                let s = lens.inverse(self.focal_from_px(size * DVec2::from(share)), max_radius);
                (low, high) = (low.min(s), high.max(s));
            }
        }
        let margin = margin * 0.5 * (high - low);
        let (low, high) = (low - margin, high + margin);
        [[low.x, high.x], [low.y, high.y]]
    }

    /// Position relative to the principal point, in units of the focal length.
    pub(super) fn focal_from_px(&self, px: DVec2) -> DVec2 {
        DVec2::new((px.x - self.cx) / self.fx, (px.y - self.cy) / self.fy)
    }

    /// Returns a projector, which computes the lens's domain once for many points or pixels.
    pub fn projector(&self) -> Projector {
        Projector { camera: *self, lens: self.coefficients(), max_radius: self.max_radius() }
    }

    /// Projects one point as [`Projector::px_from_cam`] does. For many points use [`Self::projector`].
    pub fn px_from_cam(&self, point: DVec3) -> Option<DVec2> {
        self.projector().px_from_cam(point)
    }

    /// Returns the direction of one position as [`Projector::cam_from_px`] does. For many positions use [`Self::projector`].
    pub fn cam_from_px(&self, px: DVec2) -> DVec3 {
        self.projector().cam_from_px(px)
    }
}

/// Evaluates `1 + Σ coefficientsᵢ wⁱ⁺¹` and its derivative.
fn with_slope(coefficients: &[f64], w: f64) -> [f64; 2] {
    let [value, slope, _] = with_slopes(coefficients, w);
    [value, slope]
}

/// Evaluates `1 + Σ coefficientsᵢ wⁱ⁺¹` and its first two derivatives.
fn with_slopes(coefficients: &[f64], w: f64) -> [f64; 3] {
    let mut out = [0.0; 3];
    for &coefficient in coefficients.iter().rev().chain(&[1.0]) {
        out = [out[0] * w + coefficient, out[1] * w + out[0], out[2] * w + 2.0 * out[1]];
    }
    out
}

/// Coefficients of `1 + Σ coefficientsᵢ r²⁽ⁱ⁺¹⁾` as a polynomial of the radius `r`, constant first.
fn even(coefficients: &[f64]) -> Vec<f64> {
    [1.0].iter().chain(coefficients).flat_map(|&c| [c, 0.0]).collect()
}

fn plus(a: &[f64], b: &[f64]) -> Vec<f64> {
    let at = |p: &[f64], i: usize| p.get(i).copied().unwrap_or(0.0);
    (0..a.len().max(b.len())).map(|i| at(a, i) + at(b, i)).collect()
}

fn minus(a: &[f64], b: &[f64]) -> Vec<f64> {
    plus(a, &b.iter().map(|b| -b).collect::<Vec<f64>>())
}

fn times(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; a.len() + b.len()];
    for (i, a) in a.iter().enumerate() {
        b.iter().enumerate().for_each(|(j, b)| out[i + j] += a * b);
    }
    out
}

fn derivative(p: &[f64]) -> Vec<f64> {
    p.iter().enumerate().skip(1).map(|(i, c)| i as f64 * c).collect()
}

/// Roots between zero and [`FAR`] at which a polynomial changes its sign, in ascending order. Between two such roots of its
/// derivative the polynomial is monotonic, so it has a root there if the ends have different signs, and bisection finds it.
pub(super) fn positive_roots(p: &[f64]) -> Vec<f64> {
    // The root of a factor of r is at zero, outside the open interval.
    let Some(lowest) = p.iter().position(|c| *c != 0.0) else { return Vec::new() };
    let Some(degree) = p.iter().rposition(|c| *c != 0.0).filter(|degree| *degree > lowest) else { return Vec::new() };
    let p = &p[lowest..=degree];
    let value = |r: f64| p.iter().rev().fold(0.0, |sum, c| sum * r + c);
    let mut ends = vec![0.0];
    ends.extend(positive_roots(&derivative(p)));
    ends.push(FAR);
    let root = |ends: &[f64]| {
        let (mut low, mut high) = (ends[0], ends[1]);
        let rising = value(high) > 0.0;
        if (value(low) > 0.0) == rising {
            return None;
        }
        loop {
            let middle = 0.5 * (low + high);
            if !(middle > low && middle < high) {
                return Some(low);
            }
            if (value(middle) > 0.0) == rising { high = middle } else { low = middle }
        }
    };
    ends.windows(2).filter_map(root).collect()
}
