//! The zero of the field as triangles.

use std::collections::{BTreeSet, HashMap};

use fast_surface_nets::ndshape::ConstShape3u32;
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::volume::{SIDE, Volume, Voxel};
use super::{Mesh, MeshError, components};

/// A block with one voxel of its neighbours on each side.
const HALO: usize = SIDE + 2;
type HaloShape = ConstShape3u32<{ HALO as u32 }, { HALO as u32 }, { HALO as u32 }>;

/// A vertex, in the cube of voxels of which it is the only one.
pub(super) struct Vertex {
    /// The voxel at the lowest corner.
    cube: [i32; 3],
    position: [f32; 3],
    colour: [f32; 3],
    /// Whether views have seen all eight voxels.
    pub is_seen: bool,
}

/// A mesh, of a block or whole.
#[derive(Default)]
pub(super) struct Extracted {
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<[u32; 3]>,
}

/// The surface of the whole volume.
pub(super) fn of(volume: &Volume) -> Result<Mesh, MeshError> {
    let mut at: Vec<[i32; 3]> = volume.places.keys().copied().collect();
    if volume.options.watertight {
        // Faces between a block and one that is not there belong to the latter, on the side of larger coordinates.
        let steps = [IVec3::ZERO, IVec3::X, IVec3::Y, IVec3::Z];
        let next = |at: &[i32; 3]| steps.map(|step| (IVec3::from(*at) + step).to_array());
        at = at.iter().flat_map(next).collect::<BTreeSet<_>>().into_iter().collect();
    }
    at.sort_unstable();
    let parts: Vec<Extracted> = at.into_par_iter().map(|at| of_block(volume, at)).collect();
    let mut all = welded(parts);
    let min = volume.options.min_component;
    let components = components::keep_large(&mut all, min);
    if all.triangles.is_empty() {
        return Err(MeshError::Empty { components, min });
    }
    let Extracted { vertices, triangles } = all;
    let positions: Vec<[f32; 3]> = vertices.iter().map(|vertex| vertex.position).collect();
    let normals = normals(&positions, &triangles);
    Ok(Mesh { positions, normals, colours: vertices.iter().map(|vertex| vertex.colour).collect(), triangles })
}

/// The surface in one block. Vertices on its border are those of its neighbours too.
fn of_block(volume: &Volume, at: [i32; 3]) -> Extracted {
    let (at, unseen) = (IVec3::from(at), if volume.options.watertight { 1.0 } else { f32::NAN });
    let near: Vec<_> =
        (0..27).map(|i| volume.block((at + IVec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1)).to_array())).collect();
    let mut halo = vec![Voxel::default(); HALO * HALO * HALO];
    for (i, voxel) in halo.iter_mut().enumerate() {
        let place = [i % HALO, i / HALO % HALO, i / HALO / HALO].map(|along| along + SIDE - 1);
        let [x, y, z] = place.map(|along| along / SIDE);
        if let Some(block) = near[x + 3 * y + 9 * z] {
            let [x, y, z] = place.map(|along| along % SIDE);
            *voxel = block[x + SIDE * (y + SIDE * z)];
        }
    }
    let distance = |voxel: &Voxel| if voxel.weight > 0.0 { voxel.distance } else { unseen };
    let field: Vec<f32> = halo.iter().map(distance).collect();
    let mut found = SurfaceNetsBuffer::default();
    surface_nets(&field, &HaloShape {}, [0; 3], [HALO as u32 - 1; 3], &mut found);
    let vertex = |(position, cube): (&[f32; 3], &[u32; 3])| {
        let corner = SIDE as i32 * at - 1;
        let within = Vec3::from(*position) - Vec3::from(cube.map(|along| along as f32));
        let (mut sum, mut is_seen) = ([0.0_f32; 4], true);
        for i in 0..8 {
            let [x, y, z] = [i & 1, i >> 1 & 1, i >> 2];
            let voxel = halo[(cube[0] as usize + x) + HALO * ((cube[1] as usize + y) + HALO * (cube[2] as usize + z))];
            let share = |along: f32, upper: usize| if upper == 1 { along } else { 1.0 - along };
            let weight = share(within.x, x) * share(within.y, y) * share(within.z, z);
            sum.iter_mut().zip(voxel.colour).for_each(|(sum, value)| *sum += weight * value);
            is_seen &= voxel.weight > 0.0;
        }
        let position = (corner.as_dvec3() + Vec3::from(*position).as_dvec3()) * volume.voxel;
        let colour = [0, 1, 2].map(|channel| if sum[3] > 0.0 { sum[channel] / sum[3] } else { 0.5 });
        let cube = (corner + IVec3::from(cube.map(|along| along as i32))).to_array();
        Vertex { cube, position: position.as_vec3().to_array(), colour, is_seen }
    };
    let vertices: Vec<Vertex> = found.positions.iter().zip(&found.surface_points).map(vertex).collect();
    // A position is NaN if a crossed edge of its cube leads to an unseen voxel.
    let is_surface = |triangle: &&[u32; 3]| triangle.iter().all(|&i| !vertices[i as usize].position[0].is_nan());
    let triangles = found.indices.as_chunks().0.iter().filter(is_surface).copied().collect();
    Extracted { vertices, triangles }
}

/// Joins the surfaces of blocks: a cube has one vertex. Those without triangles stay.
fn welded(parts: Vec<Extracted>) -> Extracted {
    let mut all = Extracted::default();
    let mut shared = HashMap::new();
    for part in parts {
        let index = |vertex: Vertex| {
            let new = all.vertices.len() as u32;
            // Cubes at the lower border are at the upper border of the neighbour, whose last voxels they begin at.
            let is_shared = vertex.cube.iter().any(|along| along.rem_euclid(SIDE as i32) == SIDE as i32 - 1);
            let index = if is_shared { *shared.entry(vertex.cube).or_insert(new) } else { new };
            if index == new {
                all.vertices.push(vertex);
            }
            index
        };
        let indices: Vec<u32> = part.vertices.into_iter().map(index).collect();
        all.triangles.extend(part.triangles.iter().map(|triangle| triangle.map(|i| indices[i as usize])));
    }
    all
}

/// Unit normals of vertices.
fn normals(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut sums = vec![Vec3::ZERO; positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|i| Vec3::from(positions[i as usize]));
        let across = (b - a).cross(c - a);
        triangle.iter().for_each(|&i| sums[i as usize] += across);
    }
    sums.into_iter().map(|sum| sum.try_normalize().unwrap_or(Vec3::Z).to_array()).collect()
}
