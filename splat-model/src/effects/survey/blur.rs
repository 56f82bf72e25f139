//! Sharpness of the photographs.

use std::ops::RangeInclusive;

use serde::Serialize;

use super::observations::PointObservations;
use super::pictures::Glance;
use super::{Capture, quantile};
use crate::capture::Photo;

/// Sharpness of the photographs: the energy of differences between neighbouring pixels divided by that between pixels three
/// apart, in the least sharp of four directions, because camera motion blurs along its direction only. It is one ninth for
/// a smooth picture and 1 for noise, for any contrast. The value of a sharp picture depends on its content, so sharpness is
/// compared within a capture, and around the same points.
#[derive(Clone, Debug, Serialize)]
pub struct BlurEvidence {
    /// Median over the photographs.
    pub median: Option<f64>,
    /// Quantile that a twentieth of the photographs are below.
    pub least: Option<f64>,
    /// Name of the least sharp photograph.
    pub least_sharp: Option<String>,
    /// Sharpness around the points of a photograph, relative to that around the same points in photographs from a like distance: quantile
    /// that a twentieth of the photographs are below. `None` if no photographs share enough points.
    pub least_of_same: Option<f64>,
}

pub(super) fn evidence(capture: &Capture, glances: &[Glance], observations: &PointObservations) -> BlurEvidence {
    let known = glances.iter().filter_map(|glance| Some((glance.view, glance.sharpness?)));
    let least_sharp = known.clone().min_by(|a, b| a.1.total_cmp(&b.1));
    let mut values: Vec<f64> = known.map(|(_, sharpness)| sharpness).collect();
    BlurEvidence {
        median: quantile(&mut values, 0.5),
        least: quantile(&mut values, 0.05),
        least_sharp: least_sharp.map(|(view, _)| capture.views[view].name.clone()),
        least_of_same: quantile(&mut relative(observations, capture.views.len()), 0.05),
    }
}

/// Largest ratio of the sizes of a point in two photographs that are compared. A point looks smoother from nearby.
const LIKE_SIZE: f64 = 1.25;

/// Smallest number of points by which a photograph is compared.
const FEWEST_POINTS: usize = 20;

/// The sharpness of each photograph around its points relative to that of others around the same points, where enough are shared.
fn relative(observations: &PointObservations, views: usize) -> Vec<f64> {
    let mut sums = vec![(0, Detail::default(), Detail::default()); views];
    for seen in &observations.points {
        let known = || seen.iter().filter_map(|one| Some((one, one.sample?.detail?)));
        for (one, own) in known() {
            let is_like = |footprint: f64| footprint.max(one.footprint) <= LIKE_SIZE * footprint.min(one.footprint);
            let (mut count, mut others) = (0, Detail::default());
            for (_, detail) in known().filter(|(other, _)| other.view != one.view && is_like(other.footprint)) {
                count += 1;
                others.add(&detail, 1.0);
            }
            if count > 0 {
                let (points, of_view, of_others) = &mut sums[one.view];
                *points += 1;
                of_view.add(&own, 1.0);
                of_others.add(&others, 1.0 / f64::from(count));
            }
        }
    }
    let enough = sums.into_iter().filter(|(points, ..)| *points >= FEWEST_POINTS);
    enough.filter_map(|(_, own, others)| Some(own.sharpness()? / others.sharpness()?)).collect()
}

/// Energies of the differences around a point along each of [`DIRECTIONS`]: of neighbours, and of pixels [`APART`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Detail {
    near: [f64; 4],
    far: [f64; 4],
}

impl Detail {
    /// Side of the square around a point, px: `2 REACH + 1`.
    const REACH: usize = 4;

    /// The energies around a pixel. `None` at the border of the picture.
    pub fn around(photo: &Photo, [x, y]: [usize; 2]) -> Option<Self> {
        let (width, height) = (photo.intrinsics.width, photo.intrinsics.height);
        let border = Self::REACH + APART;
        if x < border || y < border || x + border >= width || y + border >= height {
            return None;
        }
        let (rows, columns) = (y - Self::REACH..=y + Self::REACH, x - Self::REACH..=x + Self::REACH);
        let mut found = Self::default();
        for (i, direction) in DIRECTIONS.into_iter().enumerate() {
            let value = |pixel: usize| photo.rgb[3 * pixel + 1];
            let energies = energies(direction, rows.clone(), columns.clone(), width, value);
            [found.near[i], found.far[i]] = energies.map(|energy| energy as f64);
        }
        Some(found)
    }

    fn add(&mut self, other: &Self, weight: f64) {
        for i in 0..DIRECTIONS.len() {
            self.near[i] += weight * other.near[i];
            self.far[i] += weight * other.far[i];
        }
    }

    fn sharpness(&self) -> Option<f64> {
        let ratios = self.near.iter().zip(&self.far).filter(|(_, far)| **far > 0.0).map(|(near, far)| near / far);
        ratios.min_by(f64::total_cmp)
    }
}

/// Directions of the differences, as steps of columns and rows.
const DIRECTIONS: [[isize; 2]; 4] = [[1, 0], [0, 1], [1, 1], [1, -1]];

/// Distance between the pixels of the denominator. Blur over a smaller distance leaves differences between them.
const APART: usize = 3;

/// Sharpness of the green channel, which every camera measures best. `None` if the picture is constant.
pub(super) fn sharpness(photo: &Photo) -> Option<f64> {
    sharpness_by([photo.intrinsics.width, photo.intrinsics.height], |pixel| photo.rgb[3 * pixel + 1])
}

/// Sharpness of a grey picture `[H, W]` as [`BlurEvidence`] defines it. `None` if the picture is constant.
///
/// # Panics
/// If `grey` does not have `width · height` values.
pub fn sharpness_of_grey(grey: &[u8], [width, height]: [usize; 2]) -> Option<f64> {
    assert_eq!(grey.len(), width * height, "a value for each pixel");
    sharpness_by([width, height], |pixel| grey[pixel])
}

fn sharpness_by([width, height]: [usize; 2], value: impl Fn(usize) -> u8) -> Option<f64> {
    if width <= APART || height <= 2 * APART {
        return None;
    }
    // The range of rows is symmetric, because steps go up and down.
    let (rows, columns) = (APART..=height - APART - 1, 0..=width - APART - 1);
    let along = |direction| {
        let [near, far] = energies(direction, rows.clone(), columns.clone(), width, &value);
        (far > 0).then(|| near as f64 / far as f64)
    };
    DIRECTIONS.into_iter().filter_map(along).min_by(f64::total_cmp)
}

/// Sums of squared differences along a direction, between neighbours and between pixels [`APART`], over pixels of these rows and columns.
fn energies(
    [right, down]: [isize; 2],
    rows: RangeInclusive<usize>,
    columns: RangeInclusive<usize>,
    width: usize,
    value: impl Fn(usize) -> u8,
) -> [i64; 2] {
    let at = |x: usize, y: usize, steps: usize| {
        let (x, y) = (x.wrapping_add_signed(right * steps as isize), y.wrapping_add_signed(down * steps as isize));
        i64::from(value(y * width + x))
    };
    let (mut near, mut far) = (0, 0);
    for y in rows {
        for x in columns.clone() {
            let here = at(x, y, 0);
            near += (at(x, y, 1) - here).pow(2);
            far += (at(x, y, APART) - here).pow(2);
        }
    }
    [near, far]
}

#[cfg(test)]
mod tests;
