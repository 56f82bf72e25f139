//! Packing of Gaussians into bytes, and unpacking. See the table of [this folder](super).

use std::f64::consts::FRAC_1_SQRT_2;

use half::f16;

use crate::formats::frame::HalfTurn;
use crate::formats::{opacity, quaternion};
use crate::gaussians::GaussianRows;

/// Signs of the axes of the format's frame, right-up-back.
const AXES: [f32; 3] = HalfTurn::X.axes();

/// Share of a colour's range that one unit of the coefficient covers.
const COLOUR: f64 = 0.15;

/// The largest position in 24 bits.
pub(super) const MOST: f64 = 8_388_607.0;

/// Maximum number of fractional bits, so that `1 << bits` in readers does not overflow.
const FRACTION_MAX: u32 = 24;

/// Largest stored magnitude of a rotation's component.
const SIZES: f64 = 511.0;

/// The layout of the sections, from the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Version of the format, 1 to 4.
    pub version: u32,
    /// Number of Gaussians.
    pub count: usize,
    /// Degree of the spherical harmonics.
    pub sh_degree: usize,
    /// Number of fractional bits of positions.
    pub fraction: u32,
}

pub(super) const SECTIONS: usize = 6;

impl Layout {
    /// Number of bytes of a Gaussian in each section.
    pub fn bytes(&self) -> [usize; SECTIONS] {
        let position = if self.version == 1 { 6 } else { 9 };
        let rotation = if self.version < 3 { 3 } else { 4 };
        [position, 1, 3, 3, rotation, 3 * ((self.sh_degree + 1) * (self.sh_degree + 1) - 1)]
    }
}

pub(in crate::formats) fn farthest<'a>(means: impl IntoIterator<Item = &'a [f32; 3]>) -> f64 {
    means.into_iter().flatten().fold(0.0, |far, x| far.max(f64::from(x.abs())))
}

/// The largest number of fractional bits with which positions up to `farthest` fit.
pub(super) fn fraction(farthest: f64) -> u32 {
    let fits = |bits: &u32| (farthest * f64::from(1_u32 << bits)).round() <= MOST;
    (0..=FRACTION_MAX).rev().find(fits).unwrap_or(0)
}

fn byte(value: f64) -> u8 {
    // The cast clamps.
    value.round() as u8
}

/// The bytes of all Gaussians, section by section, in the layout of versions 3 and 4. Harmonics are rounded to `sh_bits` of their eight
/// bits, at degree 1 and above it.
pub(super) fn pack(rows: &GaussianRows, fraction: u32, sh_bits: [u8; 2]) -> [Vec<u8>; SECTIONS] {
    let unit = f64::from(1_u32 << fraction);
    let positions = rows.means.iter().flat_map(|mean| {
        [0, 1, 2].map(|axis| {
            let steps = (f64::from(AXES[axis] * mean[axis]) * unit).round().clamp(-MOST - 1.0, MOST) as i32;
            let [a, b, c, _] = steps.to_le_bytes();
            [a, b, c]
        })
    });
    let rest = rows.rest_per_row().max(1);
    let harmonics = rows.sh_rest.iter().enumerate().map(|(i, value)| {
        let k = 1 + i % rest / 3;
        let step = f64::from(256_u32 >> sh_bits[usize::from(k >= 4)].min(8));
        byte(128.0 + step * (128.0 / step * f64::from(HalfTurn::X.sign(k) * value)).round())
    });
    [
        positions.flatten().collect(),
        rows.logit_opacities.iter().map(|&logit| opacity::level(logit)).collect(),
        rows.sh_dc.as_flattened().iter().map(|&dc| byte(127.5 + 255.0 * COLOUR * f64::from(dc))).collect(),
        rows.log_scales.as_flattened().iter().map(|&log| byte(16.0 * (f64::from(log) + 10.0))).collect(),
        rows.rotations.iter().flat_map(|rotation| pack_rotation(rotation).to_le_bytes()).collect(),
        harmonics.collect(),
    ]
}

fn pack_rotation(&[w, x, y, z]: &[f32; 4]) -> u32 {
    let (largest, three) = quaternion::smallest_three([AXES[0] * x, AXES[1] * y, AXES[2] * z, w]);
    three.iter().fold(largest as u32, |word, value| {
        let size = (SIZES * value.abs() / FRAC_1_SQRT_2).round().min(SIZES) as u32;
        word << 10 | u32::from(*value < 0.0) << 9 | size
    })
}

/// Unpacks Gaussians from parts of the sections with the bytes of the same rows.
pub(super) fn unpack(layout: &Layout, sections: [&[u8]; SECTIONS]) -> GaussianRows {
    let [positions, opacities, colours, scales, rotations, harmonics] = sections;
    let three = |values: Vec<f32>| values.as_chunks::<3>().0.to_vec();
    let coordinates: Vec<f32> = match layout.version {
        1 => positions.as_chunks().0.iter().map(|&bytes| f16::from_le_bytes(bytes).to_f32()).collect(),
        _ => {
            let unit = f64::from(1_u32 << layout.fraction);
            // In the upper three bytes the sign bit is in its place.
            let steps = |&[a, b, c]: &[u8; 3]| i32::from_le_bytes([0, a, b, c]) >> 8;
            positions.as_chunks().0.iter().map(|bytes| (f64::from(steps(bytes)) / unit) as f32).collect()
        }
    };
    let mut means = three(coordinates);
    for mean in &mut means {
        *mean = [0, 1, 2].map(|axis| AXES[axis] * mean[axis]);
    }
    let rotations = match layout.version {
        1 | 2 => rotations.as_chunks().0.iter().map(unpack_first_three).collect(),
        _ => rotations.as_chunks().0.iter().map(|&bytes| unpack_rotation(u32::from_le_bytes(bytes))).collect(),
    };
    let rest = layout.bytes()[SECTIONS - 1].max(1);
    let harmonic =
        |(i, &level): (usize, &u8)| HalfTurn::X.sign(1 + i % rest / 3) * ((f32::from(level) - 128.0) / 128.0);
    GaussianRows {
        means,
        rotations,
        log_scales: three(scales.iter().map(|&level| f32::from(level) / 16.0 - 10.0).collect()),
        logit_opacities: opacities.iter().map(|&level| opacity::logit(level)).collect(),
        sh_dc: three(colours.iter().map(|&level| ((f64::from(level) / 255.0 - 0.5) / COLOUR) as f32).collect()),
        sh_rest: harmonics.iter().enumerate().map(harmonic).collect(),
        sh_degree: layout.sh_degree,
        groups: Vec::new(),
    }
}

fn turned([x, y, z, w]: [f32; 4]) -> [f32; 4] {
    [w, AXES[0] * x, AXES[1] * y, AXES[2] * z]
}

fn unpack_rotation(word: u32) -> [f32; 4] {
    let three = [20, 10, 0].map(|shift| {
        let size = FRAC_1_SQRT_2 * f64::from(word >> shift & 0x1ff) / SIZES;
        if word >> (shift + 9) & 1 == 1 { -size } else { size }
    });
    turned(quaternion::from_smallest_three((word >> 30) as usize, three))
}

fn unpack_first_three(bytes: &[u8; 3]) -> [f32; 4] {
    turned(quaternion::from_smallest_three(3, bytes.map(|byte| f64::from(byte) / 127.5 - 1.0)))
}
