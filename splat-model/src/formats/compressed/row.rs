//! Rows of the three elements, and the slot of each property.

use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

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

/// Number of higher coefficients at degree 3.
const COEFFICIENTS: usize = 45;

/// The ranges of a chunk, in the order of [`RANGES`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ranges(pub [f32; 18]);

impl PropertyAccess for Ranges {
    fn new() -> Self {
        let mut ranges = [0.0; 18];
        ranges[15..].fill(1.0);
        Self(ranges)
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let Some(slot) = RANGES.iter().position(|range| *range == name) else { return PropertyAccessResult::Ignored };
        match property.to_f32_lossy() {
            Some(value) => {
                self.0[slot] = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::UnsupportedType,
        }
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        RANGES.iter().position(|range| *range == name).map(|slot| self.0[slot])
    }
}

/// The words of a Gaussian, in the order of [`PACKED`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Words(pub [u32; 4]);

impl Words {
    fn slot(name: &str) -> Option<usize> {
        PACKED.iter().position(|word| *word == name)
    }
}

impl PropertyAccess for Words {
    fn new() -> Self {
        Self([0; 4])
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match (Self::slot(name), property) {
            (Some(slot), Property::UInt(value)) => {
                self.0[slot] = value;
                PropertyAccessResult::Set
            }
            (Some(_), _) => PropertyAccessResult::UnsupportedType,
            (None, _) => PropertyAccessResult::Ignored,
        }
    }

    fn get_uint(&self, name: &str) -> Option<u32> {
        Self::slot(name).map(|slot| self.0[slot])
    }
}

/// The higher coefficients of a Gaussian in the order of the file, channel by channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Levels(pub [u8; COEFFICIENTS]);

impl Levels {
    fn slot(name: &str) -> Option<usize> {
        let slot = name.strip_prefix("f_rest_")?.parse().ok()?;
        (slot < COEFFICIENTS).then_some(slot)
    }
}

impl PropertyAccess for Levels {
    fn new() -> Self {
        Self([0; COEFFICIENTS])
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match (Self::slot(name), property) {
            (Some(slot), Property::UChar(value)) => {
                self.0[slot] = value;
                PropertyAccessResult::Set
            }
            (Some(_), _) => PropertyAccessResult::UnsupportedType,
            (None, _) => PropertyAccessResult::Ignored,
        }
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        Self::slot(name).map(|slot| self.0[slot])
    }
}
