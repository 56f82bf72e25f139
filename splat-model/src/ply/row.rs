//! One Gaussian as a row of a PLY file, and the slot of each property.

use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use crate::gaussians::GaussianRows;

/// The highest degree of the spherical harmonics.
pub(super) const MAX_DEGREE: usize = 4;

const MEAN: usize = 0;
const DC: usize = 3;
const OPACITY: usize = 6;
const SCALE: usize = 7;
const ROTATION: usize = 10;
const REST: usize = 14;
const SLOTS: usize = REST + 3 * rest_per_channel(MAX_DEGREE);

/// The properties that every Gaussian needs, in the order of their slots.
pub(super) const REQUIRED: [&str; REST] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",
    "rot_3",
];

/// Number of higher coefficients per colour channel at a degree of the spherical harmonics.
pub(super) const fn rest_per_channel(degree: usize) -> usize {
    (degree + 1) * (degree + 1) - 1
}

/// The degree with `rest` properties `f_rest_*`, if there is one.
pub(super) fn degree_of_rest(rest: usize) -> Option<usize> {
    (0..=MAX_DEGREE).find(|&degree| 3 * rest_per_channel(degree) == rest)
}

/// The names of all properties in the order of the original code.
pub(super) fn names(degree: usize) -> Vec<String> {
    let numbered = |stem: &'static str, count: usize| (0..count).map(move |i| format!("{stem}_{i}"));
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(String::from).to_vec();
    names.extend(numbered("f_dc", 3));
    names.extend(numbered("f_rest", 3 * rest_per_channel(degree)));
    names.push("opacity".into());
    names.extend(numbered("scale", 3));
    names.extend(numbered("rot", 4));
    names
}

/// The slot of a property; `None` if Gaussians do not have it.
///
/// The function is called for every value of a file, 62 million times for a large scene, so it is a `match` on the name, not a
/// hash map.
pub(super) fn slot(name: &str) -> Option<usize> {
    Some(match name {
        "x" => MEAN,
        "y" => MEAN + 1,
        "z" => MEAN + 2,
        "f_dc_0" => DC,
        "f_dc_1" => DC + 1,
        "f_dc_2" => DC + 2,
        "opacity" => OPACITY,
        "scale_0" => SCALE,
        "scale_1" => SCALE + 1,
        "scale_2" => SCALE + 2,
        "rot_0" => ROTATION,
        "rot_1" => ROTATION + 1,
        "rot_2" => ROTATION + 2,
        "rot_3" => ROTATION + 3,
        _ => REST + rest_index(name)?,
    })
}

/// The number of `f_rest_<number>`, if it occurs at [`MAX_DEGREE`] and is written without leading zeros.
fn rest_index(name: &str) -> Option<usize> {
    let index = match name.strip_prefix("f_rest_")?.as_bytes() {
        [one @ b'0'..=b'9'] => usize::from(one - b'0'),
        [ten @ b'1'..=b'9', one @ b'0'..=b'9'] => 10 * usize::from(ten - b'0') + usize::from(one - b'0'),
        _ => return None,
    };
    (index < SLOTS - REST).then_some(index)
}

/// The values of one Gaussian, by [`slot`].
pub(super) struct PlyRow([f32; SLOTS]);

impl PlyRow {
    /// Copies row `i` of the scene. All fields must have that row.
    pub(super) fn of(rows: &GaussianRows, i: usize) -> Self {
        let mut row = Self::new();
        let values = &mut row.0;
        values[MEAN..][..3].copy_from_slice(&rows.means[i]);
        values[DC..][..3].copy_from_slice(&rows.sh_dc[i]);
        values[OPACITY] = rows.logit_opacities[i];
        values[SCALE..][..3].copy_from_slice(&rows.log_scales[i]);
        values[ROTATION..][..4].copy_from_slice(&rows.rotations[i]);
        let per_channel = rest_per_channel(rows.sh_degree);
        let rest = &rows.sh_rest[3 * per_channel * i..][..3 * per_channel];
        for (coefficient, channels) in rest.chunks_exact(3).enumerate() {
            for (channel, &value) in channels.iter().enumerate() {
                values[REST + channel * per_channel + coefficient] = value;
            }
        }
        row
    }

    /// Appends the row to a scene, whose degree gives the number of coefficients.
    pub(super) fn push_to(&self, rows: &mut GaussianRows) {
        let three = |slot: usize| [self.0[slot], self.0[slot + 1], self.0[slot + 2]];
        rows.means.push(three(MEAN));
        rows.sh_dc.push(three(DC));
        rows.logit_opacities.push(self.0[OPACITY]);
        rows.log_scales.push(three(SCALE));
        let [x, y, z] = three(ROTATION + 1);
        rows.rotations.push([self.0[ROTATION], x, y, z]);
        let per_channel = rest_per_channel(rows.sh_degree);
        for coefficient in REST..REST + per_channel {
            rows.sh_rest.extend([0, 1, 2].map(|channel| self.0[coefficient + channel * per_channel]));
        }
    }

    fn set(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        match slot(name) {
            Some(slot) => {
                self.0[slot] = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }
}

impl PropertyAccess for PlyRow {
    fn new() -> Self {
        Self([0.0; SLOTS])
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match property.to_f32_lossy() {
            Some(value) => self.set(name, value),
            None => PropertyAccessResult::UnsupportedType,
        }
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        match slot(name) {
            Some(slot) => Some(self.0[slot]),
            None => ["nx", "ny", "nz"].contains(&name).then_some(0.0),
        }
    }
}

/// The row of an element that is skipped.
pub(super) struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}
