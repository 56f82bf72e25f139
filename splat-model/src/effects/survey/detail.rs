//! Differences between neighbouring pixels.

use std::ops::RangeInclusive;

use crate::capture::Photo;

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

    pub fn add(&mut self, other: &Self, weight: f64) {
        for i in 0..DIRECTIONS.len() {
            self.near[i] += weight * other.near[i];
            self.far[i] += weight * other.far[i];
        }
    }

    pub fn sharpness(&self) -> Option<f64> {
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

/// Sharpness of a grey picture `[H, W]` as [`BlurEvidence`](super::BlurEvidence) defines it. `None` if the picture is constant.
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
