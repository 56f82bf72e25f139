//! SuperSplat's compressed PLY, as PlayCanvas' engine, SuperSplat and `splat-transform` write it (from the sources of
//! `splat-transform` 2.7.1, `decompress-ply.ts`). It is read, not written.
//!
//! Gaussians are stored in chunks of 256 neighbours in space. Each element has one row per Gaussian unless stated otherwise:
//!
//! | element | property | holds |
//! |---|---|---|
//! | `chunk`, a row for each 256 | `min_x` … `max_z`, `min_scale_x` … `max_scale_z`, `min_r` … `max_b` (`float`) | the chunk's smallest and largest centre, logarithm of the standard deviation, and colour `0.5 + 0.28209479 f_dc`; in files without colours the range is 0 to 1 |
//! | `vertex` | `packed_position` (`uint`) | `x` 11 bits, `y` 10, `z` 11, from the highest bit on: 0 is the chunk's smallest, all ones its largest |
//! | | `packed_rotation` | 2 bits for the index of the largest of `w x y z`, then 10 bits for each other component from −√½ to √½ |
//! | | `packed_scale` | as the position |
//! | | `packed_color` | red, green and blue in the chunk's range, opacity from 0 to 1: 8 bits each |
//! | `sh`, absent at degree 0 | `f_rest_0` … (`uchar`) | higher coefficients from −4 to 4 in 256 steps, all of red, then green, then blue; degree 1 to 3 |
//!
//! Frames, axes, harmonics and the comment with the origin are as in the original layout ([`crate::ply`]).

mod read;
#[cfg(test)]
mod tests;
mod unpack;

use ply_rs_bw::ply::Header;

pub(super) use read::read;

use crate::ply::VERTEX;

pub(super) const DEGREE_MAX: usize = 3;

/// Number of Gaussians that share a range.
const CHUNK: usize = 256;

/// The element that holds ranges.
const CHUNKS: &str = "chunk";

/// The element that holds higher coefficients.
const HARMONICS: &str = "sh";

/// Properties of a chunk: for each quantity the smallest values, then the largest. Old files lack those of colours.
const RANGES: [[&str; 6]; 3] = [
    ["min_x", "min_y", "min_z", "max_x", "max_y", "max_z"],
    ["min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z"],
    ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"],
];

const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// The ranges of a chunk, in the order of [`RANGES`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ranges([f32; 18]);

/// Whether a PLY file's header has this layout.
pub(super) fn is_compressed(header: &Header) -> bool {
    header.elements.get(VERTEX).is_some_and(|vertex| vertex.properties.contains_key(PACKED[0]))
}
