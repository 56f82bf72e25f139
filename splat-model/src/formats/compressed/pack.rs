//! Packing of Gaussians into words of bits, and unpacking. See the table of [this folder](super).

use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use super::Ranges;
use crate::formats::{limits, opacity, quaternion};
use crate::gaussians::{DC, GaussianRows};

/// First bit and number of bits of each axis in the word of a position or a scale.
const AXES: [(u32, u32); 3] = [(21, 11), (11, 10), (0, 11)];

/// Index of each quantity in [`Ranges`]: its three smallest values, then its three largest.
const POSITION: usize = 0;
const SCALE: usize = 6;
const COLOUR: usize = 12;

/// Logarithms of standard deviations are clamped to ± this, as in `splat-transform`, because a single size near zero would take
/// the precision of a whole chunk.
const SCALE_MAX: f32 = 20.0;

/// Number of steps of a higher coefficient from −4 to 4.
const STEPS: f64 = 256.0;

/// The largest integer of `bits` bits.
fn most(bits: u32) -> f64 {
    f64::from((1_u32 << bits) - 1)
}

/// Quantises a share of a range, 0 to 1, to `bits` bits.
fn level(share: f64, bits: u32) -> u32 {
    // The cast clamps from below.
    (share * most(bits)).round().min(most(bits)) as u32
}

/// The share of a range, 0 to 1, from `bits` bits of a word at `shift`.
fn share(word: u32, shift: u32, bits: u32) -> f64 {
    f64::from(word >> shift & ((1 << bits) - 1)) / most(bits)
}

/// Colours by channel, as stored in chunks.
fn colour(dc: &[f32; 3]) -> [f32; 3] {
    dc.map(|dc| (0.5 + DC * f64::from(dc)) as f32)
}

impl Ranges {
    /// Computes the ranges of the rows `of`, at least one.
    pub fn around(rows: &GaussianRows, of: std::ops::Range<usize>) -> Self {
        let mut ranges = [0.0; 18];
        let mut span = |at: usize, values: &mut dyn Iterator<Item = [f32; 3]>| {
            let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
            for value in values {
                low = [0, 1, 2].map(|axis| low[axis].min(value[axis]));
                high = [0, 1, 2].map(|axis| high[axis].max(value[axis]));
            }
            ranges[at..at + 3].copy_from_slice(&low);
            ranges[at + 3..at + 6].copy_from_slice(&high);
        };
        span(POSITION, &mut rows.means[of.clone()].iter().copied());
        span(
            SCALE,
            &mut rows.log_scales[of.clone()].iter().map(|scale| scale.map(|log| log.clamp(-SCALE_MAX, SCALE_MAX))),
        );
        span(COLOUR, &mut rows.sh_dc[of].iter().map(colour));
        Self(ranges)
    }

    /// The range of an axis, in f64, because the difference of two f32 values may overflow f32.
    fn of(&self, at: usize, axis: usize) -> (f64, f64) {
        (f64::from(self.0[at + axis]), f64::from(self.0[at + 3 + axis]))
    }

    fn share(&self, at: usize, axis: usize, value: f32) -> f64 {
        let (low, high) = self.of(at, axis);
        if high > low { (f64::from(value) - low) / (high - low) } else { 0.0 }
    }

    fn value(&self, at: usize, axis: usize, share: f64) -> f64 {
        match self.of(at, axis) {
            // Zero times infinity is NaN.
            (low, _) if share == 0.0 => low,
            (_, high) if share == 1.0 => high,
            (low, high) => low * (1.0 - share) + high * share,
        }
    }

    fn pack_axes(&self, at: usize, values: &[f32; 3]) -> u32 {
        let part = |axis: usize| level(self.share(at, axis, values[axis]), AXES[axis].1) << AXES[axis].0;
        part(0) | part(1) | part(2)
    }

    fn unpack_axes(&self, at: usize, word: u32) -> [f32; 3] {
        [0, 1, 2].map(|axis| {
            let (shift, bits) = AXES[axis];
            self.value(at, axis, share(word, shift, bits)) as f32
        })
    }

    /// Packs row `i` of a scene; its values lie within these ranges.
    pub fn pack(&self, rows: &GaussianRows, i: usize) -> [u32; 4] {
        let (largest, three) = quaternion::smallest_three(rows.rotations[i]);
        let rotation =
            three.iter().fold(largest as u32, |word, value| word << 10 | level(value * FRAC_1_SQRT_2 + 0.5, 10));
        let rgb = colour(&rows.sh_dc[i]);
        let colours = (0..3).fold(0, |word, channel| word << 8 | level(self.share(COLOUR, channel, rgb[channel]), 8));
        [
            self.pack_axes(POSITION, &rows.means[i]),
            rotation,
            self.pack_axes(SCALE, &rows.log_scales[i]),
            colours << 8 | u32::from(opacity::level(rows.logit_opacities[i])),
        ]
    }

    /// Appends a Gaussian without its higher coefficients.
    pub fn unpack_to(&self, &[position, rotation, scale, colours]: &[u32; 4], rows: &mut GaussianRows) {
        rows.means.push(self.unpack_axes(POSITION, position));
        let three = [20, 10, 0].map(|shift| (share(rotation, shift, 10) - 0.5) * SQRT_2);
        rows.rotations.push(quaternion::from_smallest_three((rotation >> 30) as usize, three));
        rows.log_scales.push(self.unpack_axes(SCALE, scale).map(limits::log_scale));
        rows.sh_dc.push([0, 1, 2].map(|channel| {
            let share = share(colours, 24 - 8 * channel as u32, 8);
            ((self.value(COLOUR, channel, share) - 0.5) / DC) as f32
        }));
        rows.logit_opacities.push(opacity::logit((colours & 0xff) as u8));
    }
}

/// Quantises the higher coefficients of a row: channels innermost before, coefficients innermost after.
pub(super) fn pack_rest(rest: &[f32]) -> impl Iterator<Item = u8> {
    let channels = (0..3).flat_map(move |channel| rest.iter().skip(channel).step_by(3));
    // Casts of floats clamp.
    channels.map(|&value| ((f64::from(value) / 8.0 + 0.5) * STEPS).floor() as u8)
}

/// The inverse of [`pack_rest`]. A level stands for the middle of its step, the first and the last level for the ends of the range.
pub(super) fn unpack_rest(levels: &[u8]) -> impl Iterator<Item = f32> {
    let coefficients = (0..levels.len() / 3).flat_map(|i| levels.iter().skip(i).step_by(levels.len() / 3));
    coefficients.map(|&level| {
        let share = match level {
            0 => 0.0,
            255 => 1.0,
            _ => (f64::from(level) + 0.5) / STEPS,
        };
        (8.0 * (share - 0.5)) as f32
    })
}
