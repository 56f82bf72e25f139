//! Differences between the rows that were written and the rows that were read.

use glam::DVec4;

use crate::gaussians::{DC, GaussianRows, sigmoid};

/// Summary of the differences of one quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// The largest difference.
    pub largest: f64,
    /// The root mean square of the differences.
    pub rms: f64,
}

/// The error of quantisation over all Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QuantisationError {
    /// Distance of centres, scene units.
    pub position: Deviation,
    /// Standard deviations, relative: 0.03 is a change by 3% in either direction.
    pub scale: Deviation,
    /// Angle between rotations, degrees. It means little for Gaussians with two axes of equal length.
    pub rotation: Deviation,
    /// Opacities, 0 to 1.
    pub opacity: Deviation,
    /// View-independent colours, by channel; 1 is the difference from black to white.
    pub colour: Deviation,
    /// Higher coefficients of the spherical harmonics.
    pub harmonics: Deviation,
}

impl QuantisationError {
    /// Computes the error of each row that was read against the written row of the same number.
    ///
    /// # Panics
    /// If they differ in number or degree, or do not fit together.
    pub fn between(written: &GaussianRows, read: &GaussianRows) -> Self {
        assert_eq!((written.len(), written.sh_degree), (read.len(), read.sh_degree), "rows of different scenes");
        let difference = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).abs();
        let flat = |a: &[[f32; 3]], b: &[[f32; 3]], of: &dyn Fn(f64) -> f64| {
            Deviation::of(a.as_flattened().iter().zip(b.as_flattened()).map(|pair| of(difference(pair))))
        };
        let distance = |(a, b): (&[f32; 3], &[f32; 3])| a.iter().zip(b).map(|pair| difference(pair).powi(2)).sum();
        let rotations = written.rotations.iter().zip(&read.rotations);
        let opacities = written.logit_opacities.iter().zip(&read.logit_opacities);
        Self {
            position: Deviation::of(written.means.iter().zip(&read.means).map(|pair| f64::sqrt(distance(pair)))),
            scale: flat(&written.log_scales, &read.log_scales, &f64::exp_m1),
            rotation: Deviation::of(rotations.map(|(a, b)| angle_degrees(a, b))),
            opacity: Deviation::of(opacities.map(|(a, b)| (sigmoid(*a) - sigmoid(*b)).abs())),
            colour: flat(&written.sh_dc, &read.sh_dc, &|difference| DC * difference),
            harmonics: Deviation::of(written.sh_rest.iter().zip(&read.sh_rest).map(difference)),
        }
    }
}

impl Deviation {
    fn of(differences: impl Iterator<Item = f64>) -> Self {
        let add = |(largest, squares, count): (f64, f64, u64), difference: f64| {
            (largest.max(difference), squares + difference * difference, count + 1)
        };
        let (largest, squares, count) = differences.fold((0.0, 0.0, 0), add);
        Self { largest, rms: if count == 0 { 0.0 } else { (squares / count as f64).sqrt() } }
    }
}

/// Angle of the rotation from `a` to `b`, degrees.
fn angle_degrees(a: &[f32; 4], b: &[f32; 4]) -> f64 {
    let [a, b] = [a, b].map(|q| DVec4::from_array(q.map(f64::from)).normalize());
    // Computed from the chord, which keeps its digits for small angles; the cosine does not.
    let chord = a.distance(b * 1.0_f64.copysign(a.dot(b)));
    4.0 * (0.5 * chord).min(1.0).asin().to_degrees()
}

#[cfg(test)]
mod tests;
