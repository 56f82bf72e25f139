//! The properties of a Gaussian, in files that are read and in files that are written.

use crate::formats::limits;
use crate::gaussians::GaussianRows;

/// The highest degree of the spherical harmonics.
pub(super) const MAX_DEGREE: usize = 4;

/// The properties that every Gaussian needs.
pub(super) const REQUIRED: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2",
    "rot_3",
];

/// Number of higher coefficients per colour channel at a degree of the spherical harmonics.
pub(super) const fn rest_per_channel(degree: usize) -> usize {
    (degree + 1) * (degree + 1) - 1
}

/// The degree with `rest` properties `f_rest_*`, if there is one.
pub(crate) fn degree_of_rest(rest: usize) -> Option<usize> {
    (0..=MAX_DEGREE).find(|&degree| 3 * rest_per_channel(degree) == rest)
}

/// The names of `count` higher coefficients.
pub(crate) fn rest_names(count: usize) -> impl Iterator<Item = String> {
    (0..count).map(|i| format!("f_rest_{i}"))
}

/// The names of all properties in the order of the original code.
pub(super) fn names(degree: usize) -> Vec<String> {
    let (before, after) = REQUIRED.split_at(6);
    let mut names: Vec<String> = before.iter().map(|name| name.to_string()).collect();
    names.splice(3..3, ["nx", "ny", "nz"].map(String::from));
    names.extend(rest_names(3 * rest_per_channel(degree)));
    names.extend(after.iter().map(|name| name.to_string()));
    names
}

/// Appends the values of Gaussian `i` to `out`, in the order of [`names`]. All fields must have that row.
pub(super) fn values_of_row(rows: &GaussianRows, i: usize, out: &mut Vec<f32>) {
    let rest = &rows.sh_rest[rows.rest_per_row() * i..][..rows.rest_per_row()];
    out.extend([rows.means[i], [0.0; 3], rows.sh_dc[i]].as_flattened());
    out.extend((0..3).flat_map(|channel| rest.iter().skip(channel).step_by(3)));
    out.push(rows.logit_opacities[i]);
    out.extend(rows.log_scales[i]);
    out.extend(rows.rotations[i]);
}

/// Appends a Gaussian with these values of [`REQUIRED`] and of `f_rest_*` to a scene of the same degree. Opacities of exactly 0 and 1 and
/// thicknesses of 0 become finite ([`limits`]).
pub(super) fn push_row(rows: &mut GaussianRows, values: &[f64]) {
    let (required, rest) = values.split_at(REQUIRED.len());
    let three = |at: usize| [0, 1, 2].map(|i| required[at + i] as f32);
    rows.means.push(three(0));
    rows.sh_dc.push(three(3));
    rows.logit_opacities.push(limits::logit(required[6] as f32));
    rows.log_scales.push(three(7).map(limits::log_scale));
    rows.rotations.push([0, 1, 2, 3].map(|i| required[10 + i] as f32));
    let per_channel = rest.len() / 3;
    for coefficient in 0..per_channel {
        rows.sh_rest.extend([0, 1, 2].map(|channel| rest[channel * per_channel + coefficient] as f32));
    }
}
