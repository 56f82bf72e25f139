//! Gaussians from words of bits. See the table of [this folder](super).

use std::f64::consts::SQRT_2;

use super::Ranges;
use crate::formats::{limits, opacity, quaternion};
use crate::gaussians::{DC, GaussianRows};

/// First bit and number of bits of each axis in the word of a position or a scale.
const AXES: [(u32, u32); 3] = [(21, 11), (11, 10), (0, 11)];

/// Index of each quantity in [`Ranges`]: its three smallest values, then its three largest.
const POSITION: usize = 0;
const SCALE: usize = 6;
const COLOUR: usize = 12;

/// Number of steps of a higher coefficient from −4 to 4.
const STEPS: f64 = 256.0;

/// The share of a range, 0 to 1, from `bits` bits of a word at `shift`.
fn share(word: u32, shift: u32, bits: u32) -> f64 {
    f64::from(word >> shift & ((1 << bits) - 1)) / f64::from((1_u32 << bits) - 1)
}

impl Ranges {
    /// A share of the range of an axis, in f64, because the difference of two f32 values may overflow f32.
    fn value(&self, at: usize, axis: usize, share: f64) -> f64 {
        match (f64::from(self.0[at + axis]), f64::from(self.0[at + 3 + axis])) {
            // Zero times infinity is NaN.
            (low, _) if share == 0.0 => low,
            (_, high) if share == 1.0 => high,
            (low, high) => low * (1.0 - share) + high * share,
        }
    }

    fn unpack_axes(&self, at: usize, word: u32) -> [f32; 3] {
        [0, 1, 2].map(|axis| {
            let (shift, bits) = AXES[axis];
            self.value(at, axis, share(word, shift, bits)) as f32
        })
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

/// The higher coefficients of a row: coefficients innermost before, channels innermost after. A level stands for the middle of its step, the
/// first and the last level for the ends of the range.
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
