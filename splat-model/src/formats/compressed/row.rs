//! The elements and their properties.

/// The element that holds ranges.
pub(super) const CHUNKS: &str = "chunk";

/// The element that holds higher coefficients.
pub(super) const HARMONICS: &str = "sh";

/// Properties of a chunk. Old files without ranges of colours lack the last six.
pub(super) const RANGES: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];

/// Properties of a Gaussian.
pub(super) const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// The ranges of a chunk, in the order of [`RANGES`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ranges(pub [f32; 18]);
