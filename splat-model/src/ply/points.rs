//! Plain points: `x y z` and, if present, colours.

use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::{PropertyType, ScalarType};

use super::VERTEX;
use super::read::{PlyReader, require, value_error, vertex};
use crate::FileError;
use crate::gaussians::DC;

/// Largest valid coordinate; its square still fits an f32. Larger values indicate damage.
const MAX_COORDINATE: f64 = 1e15;

/// Channel value of a point without a colour.
const GREY: u8 = 127;

const COORDINATES: [&str; 3] = ["x", "y", "z"];

/// The names that programs give to colours; the first that are all there count. The last are harmonics of degree 0.
const CHANNELS: [[&str; 3]; 6] = [
    ["red", "green", "blue"],
    ["diffuse_red", "diffuse_green", "diffuse_blue"],
    ["r", "g", "b"],
    ["Red", "Green", "Blue"],
    ["R", "G", "B"],
    ["f_dc_0", "f_dc_1", "f_dc_2"],
];

/// Reads points: positions, and display-referred colours from 0 to 255.
///
/// `x y z` may be of any numeric type. Colours are `red green blue`, or have another name of `CHANNELS`; they range from 0 to 1 if they are
/// floating-point numbers of at most 2, from 0 to 65,535 if they exceed 255, and else from 0 to 255, and are clamped to that range; a hundredth of the
/// rows may lie beyond. A missing channel of `red green blue` and points without colours are grey. All other content of the file is ignored.
///
/// # Errors
/// A [`FileError`] for every file that is not a complete PLY file with such points, or in which a coordinate is not finite or is
/// beyond 1e15. Memory is bounded by a small multiple of the file's true size, whatever its header claims.
pub fn read_points(path: &Path) -> Result<(Vec<DVec3>, Vec<[u8; 3]>), FileError> {
    let (mut input, header) = PlyReader::open(path)?;
    let vertex = vertex(path, &header)?;
    require(path, vertex, &COORDINATES)?;
    let has = |name: &&str| vertex.properties.contains_key(*name);
    let channels = CHANNELS.into_iter().find(|channels| channels.iter().all(has)).unwrap_or(CHANNELS[0]);
    let coloured: Vec<usize> = (0..3).filter(|&channel| has(&channels[channel])).collect();
    let is_float = |name: &str| {
        let kind = vertex.properties.get(name).map(|property| &property.data_type);
        matches!(kind, Some(PropertyType::Scalar(ScalarType::Float | ScalarType::Double)))
    };
    let floats = channels.map(is_float);
    let names: Vec<&str> = COORDINATES.into_iter().chain(coloured.iter().map(|&channel| channels[channel])).collect();
    input.begin(&header)?;
    let (mut positions, mut levels) = (Vec::with_capacity(vertex.count), Vec::with_capacity(vertex.count));
    input.each_row(vertex, header.encoding, &names, |row, values| {
        let (position, colour) = values.split_at(3);
        if let Some(axis) = position.iter().position(|value| !(value.abs() <= MAX_COORDINATE)) {
            let (name, value) = (COORDINATES[axis], position[axis]);
            let detail = format!("`{name}` is {value:e}, expected a finite number of at most 1e15");
            return Err(value_error(path, VERTEX, row, &detail));
        }
        positions.push(DVec3::from_slice(position));
        let mut level = [f32::NAN; 3];
        coloured.iter().zip(colour).for_each(|(&channel, &value)| level[channel] = value as f32);
        levels.push(level);
        Ok(())
    })?;
    // A hundredth of the rows has to agree: one row with a wild colour says nothing about the others.
    let exceed = |of_floats: bool, limit: f32| {
        let exceeds = |level: &&[f32; 3]| (0..3).any(|channel| floats[channel] == of_floats && level[channel] > limit);
        100 * levels.iter().filter(exceeds).count() > levels.len()
    };
    let is_harmonic = channels == CHANNELS[CHANNELS.len() - 1];
    let scales = floats.map(|is_float| match is_float {
        true if !exceed(true, 2.0) => 255.0,
        is_float if exceed(is_float, 255.5) => 255.0 / 65_535.0,
        _ => 1.0,
    });
    let colour = |level: [f32; 3]| {
        std::array::from_fn(|channel| match level[channel] {
            // The cast clamps to 0..255 and converts NaN to 0.
            _ if !coloured.contains(&channel) => GREY,
            level if is_harmonic => (255.0 * (0.5 + DC as f32 * level)).round() as u8,
            level => (level * scales[channel]).round() as u8,
        })
    };
    Ok((positions, levels.into_iter().map(colour).collect()))
}

#[cfg(test)]
mod tests;
