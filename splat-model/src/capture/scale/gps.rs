//! Scale from GPS: the similarity that maps camera centres to positions on Earth.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use rand::SeedableRng;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;

use super::{Scale, ScaleError};
use crate::capture::exif::{Exif, Gps};
use crate::capture::{Capture, Cut, Result};
use crate::quantile::quantile;

/// Fewest photographs with GPS. Three fit any triangle of the same shape, so that a fourth is the first that can disagree.
const MIN_PHOTOGRAPHS: usize = 4;

/// Largest standard deviation of the scale, as a fraction of it.
const MAX_DEVIATION: f64 = 0.1;

/// Random triples that are tried. If half of the positions are wrong, an eighth of the triples are right.
const DRAWS: usize = 200;

/// Positions further from their cameras than this many standard deviations, estimated from the median, are left out.
const OUTLIER: f64 = 3.0;

/// The standard deviation per axis is the median distance in three dimensions divided by this (the root of the median of χ² with
/// three degrees of freedom).
const MEDIAN_3D: f64 = 1.538_17;

/// Squarings of a matrix, after which eigenvalues that differ by a part in a billion differ by all digits of f64.
const SQUARINGS: usize = 40;

/// The scale at which the cameras' centres fit the GPS positions of the photographs' EXIF.
///
/// The similarity with the least sum of squares (Horn 1987) is fitted to triples of photographs; the one with the least median of distances
/// (Rousseeuw 1984) says which positions are outliers, and the others are fitted together.
///
/// # Errors
/// A [`CaptureError`](crate::capture::CaptureError) if a picture cannot be opened; otherwise the [`ScaleError`] if fewer than four placed photographs have a position, or
/// their noise leaves the scale uncertain by more than a tenth.
pub fn from_gps(capture: &Capture) -> Result<Result<Scale, ScaleError>> {
    let mut pairs = Vec::new();
    // The views of a panorama have one place.
    let places = capture.views.iter().filter(|view| !matches!(&view.cut, Cut::Face(face) if face.number > 0));
    for view in places.clone() {
        if let Some(gps) = Exif::read(&view.image_path)?.gps {
            pairs.push((view.cam_from_world.inverse().translation, gps));
        }
    }
    Ok(fitted(&pairs, places.count()))
}

fn fitted(pairs: &[(DVec3, Gps)], placed: usize) -> Result<Scale, ScaleError> {
    let found = pairs.len();
    if found < MIN_PHOTOGRAPHS {
        return Err(ScaleError(format!(
            "{found} of {placed} placed photographs have a GPS position in EXIF, expected at least {MIN_PHOTOGRAPHS}: switch on the location \
             in the camera"
        )));
    }
    // Heights only if all have one: a missing height is not zero.
    let heights = pairs.iter().all(|(_, gps)| gps.altitude_m.is_some());
    let first = earth_centred(pairs[0].1, heights);
    let pairs: Vec<Pair> =
        pairs.iter().map(|&(centre, gps)| Pair { centre, place_m: earth_centred(gps, heights) - first }).collect();
    let inliers = inliers(&pairs);
    let similarity = WorldFit::of(&inliers);
    let n = inliers.len() as f64;
    let sum_squares: f64 = inliers.iter().map(|pair| similarity.error(pair).powi(2)).sum();
    let mean = inliers.iter().map(|pair| pair.centre).sum::<DVec3>() / n;
    let spread: f64 = inliers.iter().map(|pair| pair.centre.distance_squared(mean)).sum();
    // Three coordinates each, less the seven numbers of the similarity.
    let variance = sum_squares / (3.0 * n - 7.0);
    let deviation = variance.sqrt() / (similarity.scale * spread.sqrt());
    if !(deviation <= MAX_DEVIATION && super::is_scale(similarity.scale)) {
        return Err(ScaleError(format!(
            "the GPS positions of {found} photographs determine the scale to ±{:.0}%, expected ±{:.0}% or better: they differ by {:.1} m from \
             the cameras, which are {:.1} m from their mean; cover more ground",
            (100.0 * deviation).min(1e3),
            100.0 * MAX_DEVIATION,
            (sum_squares / n).sqrt(),
            similarity.scale * (spread / n).sqrt()
        )));
    }
    let source = format!("the GPS positions of {} photographs, {} of which fit", found, inliers.len());
    Ok(Scale { metres_per_unit: similarity.scale, relative_deviation: Some(deviation), source })
}

/// A camera's centre, scene units, and its place on Earth, m.
#[derive(Clone, Copy, Debug)]
struct Pair {
    centre: DVec3,
    place_m: DVec3,
}

/// Position in the Earth's frame, m (WGS 84, NIMA TR8350.2, equation 4-14). A similarity does not depend on the frame's axes.
fn earth_centred(gps: Gps, with_height: bool) -> DVec3 {
    const EQUATOR_M: f64 = 6_378_137.0;
    const FLATTENING: f64 = 1.0 / 298.257_223_563;
    const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);
    let (latitude, longitude) = (gps.latitude_deg.to_radians(), gps.longitude_deg.to_radians());
    let height = gps.altitude_m.filter(|_| with_height).unwrap_or(0.0);
    let normal = EQUATOR_M / (1.0 - ECCENTRICITY_SQUARED * latitude.sin().powi(2)).sqrt();
    let around = (normal + height) * latitude.cos();
    let up = (normal * (1.0 - ECCENTRICITY_SQUARED) + height) * latitude.sin();
    DVec3::new(around * longitude.cos(), around * longitude.sin(), up)
}

fn inliers(pairs: &[Pair]) -> Vec<Pair> {
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let draw = |_| {
        let triple: Vec<Pair> = sample(&mut random, pairs.len(), 3).iter().map(|i| pairs[i]).collect();
        let similarity = WorldFit::of(&triple);
        let mut errors: Vec<f64> = pairs.iter().map(|pair| similarity.error(pair)).collect();
        (quantile(&mut errors, 0.5).unwrap_or(f64::INFINITY), similarity)
    };
    let best = (0..DRAWS).map(draw).min_by(|a, b| a.0.total_cmp(&b.0));
    let (median, similarity) = best.unwrap_or((f64::INFINITY, WorldFit::of(pairs)));
    // The median of a fit to three points is too small in small captures; a millimetre is below what GPS resolves.
    let small = 1.0 + 5.0 / pairs.len() as f64;
    let limit = (OUTLIER * small * median / MEDIAN_3D * 3f64.sqrt()).max(1e-3);
    let inliers: Vec<Pair> = pairs.iter().filter(|pair| similarity.error(pair) <= limit).copied().collect();
    if inliers.len() < MIN_PHOTOGRAPHS { pairs.to_vec() } else { inliers }
}

/// `place = scale · rotation · centre + shift`.
#[derive(Clone, Copy, Debug)]
struct WorldFit {
    scale: f64,
    rotation: DQuat,
    shift: DVec3,
}

impl WorldFit {
    /// The similarity with the least sum of squared distances from the places, whose error is that of GPS.
    fn of(pairs: &[Pair]) -> Self {
        let n = pairs.len() as f64;
        let centre = pairs.iter().map(|pair| pair.centre).sum::<DVec3>() / n;
        let place = pairs.iter().map(|pair| pair.place_m).sum::<DVec3>() / n;
        let mut products = DMat3::ZERO;
        let mut spread = 0.0;
        for pair in pairs {
            let (a, b) = (pair.centre - centre, pair.place_m - place);
            products += DMat3::from_cols(b * a.x, b * a.y, b * a.z);
            spread += a.length_squared();
        }
        let rotation = best_rotation(products);
        let along: f64 =
            pairs.iter().map(|pair| (rotation * (pair.centre - centre)).dot(pair.place_m - place)).sum::<f64>();
        let scale = if spread > 0.0 { along / spread } else { 0.0 };
        Self { scale, rotation, shift: place - scale * (rotation * centre) }
    }

    /// Distance of a place from where the similarity puts it, m.
    fn error(&self, pair: &Pair) -> f64 {
        (self.scale * (self.rotation * pair.centre) + self.shift).distance(pair.place_m)
    }
}

/// The rotation `R` with the largest `Σ b · R a`, from `Σ b aᵀ`: the eigenvector of the largest eigenvalue of Horn's symmetric 4 × 4
/// matrix (1987, section 4.A).
fn best_rotation(products: DMat3) -> DQuat {
    // `s[a][b]` is the sum of products of the coordinate `a` of the centre and `b` of the place.
    let s = products.to_cols_array_2d();
    let (yz, zx, xy) = (s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]);
    let (xy_sum, zx_sum, yz_sum) = (s[0][1] + s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1]);
    let matrix = DMat4::from_cols_array_2d(&[
        [s[0][0] + s[1][1] + s[2][2], yz, zx, xy],
        [yz, s[0][0] - s[1][1] - s[2][2], xy_sum, zx_sum],
        [zx, xy_sum, s[1][1] - s[0][0] - s[2][2], yz_sum],
        [xy, zx_sum, yz_sum, s[2][2] - s[0][0] - s[1][1]],
    ]);
    let length =
        |matrix: DMat4| DVec4::from_array(matrix.to_cols_array_2d().map(|c| DVec4::from_array(c).length())).length();
    // With no eigenvalue below zero, the largest one outgrows the others in a power of the matrix, whose columns are then its eigenvector.
    let shifted = matrix + DMat4::IDENTITY * length(matrix).max(f64::MIN_POSITIVE);
    let power = (0..SQUARINGS).fold(shifted, |power, _| {
        let power = power * length(power).recip();
        power * power
    });
    let columns = power.to_cols_array_2d().map(DVec4::from_array);
    let [w, x, y, z] =
        columns.into_iter().max_by(|a, b| a.length().total_cmp(&b.length())).unwrap_or(DVec4::X).to_array();
    DQuat::from_xyzw(x, y, z, w).normalize()
}

#[cfg(test)]
mod tests;
