//! PlayCanvas' SOG, version 2 (<https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog>): pictures in lossless WebP, with a
//! document `meta.json` that says how to read them, in one zip archive.
//!
//! Each Gaussian has the same pixel, row by row, in all pictures but the palette. Channels have eight bits.
//!
//! | picture | channels | holds |
//! |---|---|---|
//! | `means_l`, `means_u` | R, G, B | low and high byte of the axis' place from `means.mins` to `means.maxs`, of `sign(x) ln(1 + abs(x))` |
//! | `quats` | R, G, B, A | three components of the rotation `w x y z` without its largest, from −√½ to √½; 252 and the index of the largest |
//! | `scales` | R, G, B | index of the logarithm of the standard deviation in `scales.codebook` |
//! | `sh0` | R, G, B, A | index of the coefficient in `sh0.codebook`; 255 times the opacity |
//! | `shN_labels`, absent at degree 0 | R, G | low and high byte of the index in the palette of higher harmonics |
//! | `shN_centroids` | R, G, B | the palette: 64 entries in a row, a pixel per coefficient, indices in `shN.codebook` |
//!
//! The frame is that of PLY files; the format's document says otherwise, and its reference does the same. `extras` stores the origin, `antialias` the
//! mark of antialiasing.
//!
//! **Writing.** Gaussians are in Morton order, so that neighbours in pictures are alike. Codebooks are one-dimensional and palettes vector
//! quantisers, see [`codebook`] and [`palette`]. The same scene gives the same file.
//!
//! **Crates.** `image` codes WebP, `zip` the archive. `sog-decoder` 0.1 (a release candidate) reads bundles without bounds on memory, and
//! serves as another project's reader in tests.

mod codebook;
mod meta;
mod palette;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub(super) use read::read;
pub use write::SogOptions;
pub(super) use write::write;

pub(super) const DEGREE_MAX: usize = 3;

/// First bytes of a zip archive.
pub(super) const MAGIC: [u8; 4] = *b"PK\x03\x04";

/// The document's name in an archive.
pub(super) const META: &str = "meta.json";

const LEVELS: usize = 256;

/// Number of palette entries in a row of its picture.
const PER_ROW: usize = 64;

/// Alpha of a rotation whose largest component is the first.
const LARGEST: u8 = 252;

/// Largest place of a coordinate in its range.
const PLACES: f64 = 65_535.0;

/// A coordinate as it is placed: its sign, and the logarithm of one plus its magnitude.
fn compressed(coordinate: f32) -> f64 {
    let coordinate = f64::from(coordinate);
    coordinate.abs().ln_1p().copysign(coordinate)
}

/// The inverse of [`compressed`].
fn expanded(place: f64) -> f32 {
    (place.abs().exp_m1().copysign(place)) as f32
}
