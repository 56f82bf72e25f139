//! The properties of a Gaussian, in files that are read and in files that are written.

use std::collections::{HashMap, HashSet};

use crate::formats::limits;
use crate::gaussians::{BASE_GROUPS, GaussianRows, GroupOptions, GroupRows, check_name};

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

/// The names of the properties of every scene, in the order of the original code. Those of further groups follow.
pub(super) fn names(degree: usize) -> Vec<String> {
    let (before, after) = REQUIRED.split_at(6);
    let mut names: Vec<String> = before.iter().map(|name| name.to_string()).collect();
    names.splice(3..3, ["nx", "ny", "nz"].map(String::from));
    names.extend(rest_names(3 * rest_per_channel(degree)));
    names.extend(after.iter().map(|name| name.to_string()));
    names
}

/// The groups, without rows, of properties that are none of the original code's, in the order of their first properties. Properties
/// whose numbers are not 0, 1 and so on are groups of their own.
pub(super) fn further_groups<'a>(properties: impl Iterator<Item = &'a String>) -> Vec<GroupRows> {
    let own: HashSet<String> = names(MAX_DEGREE).into_iter().collect();
    let further: Vec<&String> = properties.filter(|name| !own.contains(*name) && check_name(name).is_ok()).collect();
    let all: HashSet<&String> = further.iter().copied().collect();
    let (mut groups, mut widths) = (Vec::new(), HashMap::new());
    for property in further {
        let stem = property.rsplit_once('_').filter(|(stem, i)| !stem.is_empty() && i.parse::<usize>().is_ok());
        let of_stem = stem.map(|(stem, i)| {
            let count = || (0..).take_while(|i| all.contains(&format!("{stem}_{i}"))).count();
            (stem, i, *widths.entry(stem).or_insert_with(count))
        });
        // A stem that is itself a property, or one of the scene's groups, cannot name a group.
        let usable = |stem: &str| !all.contains(&stem.to_owned()) && !BASE_GROUPS.contains(&stem);
        let group = match of_stem {
            // The first of the properties brings all of them.
            Some((stem, "0", width)) if width > 1 && usable(stem) => (stem.to_owned(), width),
            Some((stem, i, width)) if width > 1 && usable(stem) && is_number_below(i, width) => continue,
            _ if BASE_GROUPS.contains(&&**property) => continue,
            _ => (property.clone(), 1),
        };
        groups.push(group);
    }
    let rows = |(name, width)| GroupRows { name, width, values: Vec::new(), options: GroupOptions::default() };
    groups.into_iter().map(rows).collect()
}

/// Whether a name ends in a number as [`names_of`] writes it.
fn is_number_below(text: &str, most: usize) -> bool {
    text.parse::<usize>().is_ok_and(|i| i < most && i.to_string() == text)
}

/// The names of the properties of groups: a group's name, for rows of several numbers followed by `_0`, `_1` and so on.
pub(super) fn group_names(groups: &[GroupRows]) -> impl Iterator<Item = String> {
    groups.iter().flat_map(|GroupRows { name, width, .. }| match *width {
        1 => vec![name.clone()],
        width => (0..width).map(|i| format!("{name}_{i}")).collect(),
    })
}

/// Appends the values of Gaussian `i` to `out`, in the order of [`names`]. All fields must have that row.
pub(super) fn values_of_row(rows: &GaussianRows, i: usize, out: &mut Vec<f32>) {
    let rest = &rows.sh_rest[rows.rest_per_row() * i..][..rows.rest_per_row()];
    out.extend([rows.means[i], [0.0; 3], rows.sh_dc[i]].as_flattened());
    out.extend((0..3).flat_map(|channel| rest.iter().skip(channel).step_by(3)));
    out.push(rows.logit_opacities[i]);
    out.extend(rows.log_scales[i]);
    out.extend(rows.rotations[i]);
    rows.groups.iter().for_each(|group| out.extend(&group.values[group.width * i..group.width * (i + 1)]));
}

/// Appends a Gaussian with these values of [`REQUIRED`], of `f_rest_*` and of groups to a scene of the same degree and groups. Opacities of exactly 0 and 1 and
/// thicknesses of 0 become finite ([`limits`]).
pub(super) fn push_row(rows: &mut GaussianRows, values: &[f64]) {
    let (required, rest) = values.split_at(REQUIRED.len());
    let (rest, mut further) = rest.split_at(rows.rest_per_row());
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
    for group in &mut rows.groups {
        let (own, others) = further.split_at(group.width);
        group.values.extend(own.iter().map(|value| *value as f32));
        further = others;
    }
}
